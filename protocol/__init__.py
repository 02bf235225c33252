"""What is on the wire: keys, messages, codecs and the opening of sessions. Everything else stands
on this.
"""

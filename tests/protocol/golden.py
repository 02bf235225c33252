"""Golden bytes: what released versions of every message look like on the wire.

`python -m tests.protocol.golden` writes the files of versions that have none. A file that is there
is never written again: other bytes are another version, and need another name.
"""

from pathlib import Path

from fleetpose.protocol import codec
from fleetpose.protocol.messages.base import Message
from tests.protocol.message_examples import EXAMPLES

FOLDER = Path(__file__).parent / "golden"


def path_of(schema: str) -> Path:
    """Where the bytes of a version are."""
    return FOLDER / f"{schema}.bin"


def missing() -> list[Message]:
    """Examples of the messages whose newest version has no golden file."""
    return [one for one in EXAMPLES.values() if not path_of(one.schema_name).exists()]


def main() -> None:
    """Writes what is missing."""
    FOLDER.mkdir(exist_ok=True)
    for message in missing():
        with path_of(message.schema_name).open("xb") as file:
            file.write(codec.pack(message))
        print(f"{file.name} written")


if __name__ == "__main__":
    main()

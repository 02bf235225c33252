"""A recorded site put together anew by the server's own pipeline, the same way every time."""

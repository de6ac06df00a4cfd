"""Fuzzing of the readers: broken and hostile files, and the promise that each is refused by name or read."""

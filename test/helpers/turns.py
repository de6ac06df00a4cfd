"""Which slow tests a run takes: those of its turn, then those that the last day's commits concern."""

import functools
import subprocess
import zlib
from pathlib import Path


class Turn:
    """Turn K of N of the slow tests of a repository."""

    def __init__(self, turn, turns, root):
        self.turn, self.turns, self.root = turn % turns, turns, Path(root).resolve()

    def place(self, test, path):
        """Return where a slow test stands in the row: the lower, the earlier; None where it is left out."""
        if zlib.crc32(test.encode()) % self.turns == self.turn:
            return 0
        if path in self._changed:
            return 1
        return 2 if path in self._of_changed_modules else None

    def takes_file(self, path):
        """Return whether a file of default tests is among those of the turn."""
        return zlib.crc32(Path(path).relative_to(self.root).as_posix().encode()) % self.turns == self.turn

    @functools.cached_property
    def _changed(self):
        """The files that commits of the last day changed; none where there is no history."""
        command = ["git", "-C", self.root, "log", "--since=1.day", "--name-only", "--format="]
        listed = subprocess.run(command, capture_output=True, text=True)
        return {self.root / name for name in listed.stdout.splitlines() if name}

    @functools.cached_property
    def _of_changed_modules(self):
        return {test for path in self._changed for test in self._tests_of(path.relative_to(self.root))}

    def _tests_of(self, module):
        """Return the test files of a module's name; where there are none, those of its folder."""
        if module.parts[0] != "odak" or module.suffix != ".py":
            return []
        tests = self.root / "test"
        folder = tests.joinpath(*module.parent.parts[1:])
        return list(tests.rglob(f"test_{module.stem.strip('_')}.py")) or list(folder.glob("test_*.py"))

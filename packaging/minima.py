"""Prints the oldest versions that pyproject.toml admits, as constraints for pip; torch is pinned by requirements.txt.

python packaging/minima.py > minima.txt && pip install torch==2.13.0 -e ".[test]" -c minima.txt
"""

import re
from pathlib import Path

TEXT = (Path(__file__).resolve().parents[1] / "pyproject.toml").read_text(encoding="utf-8")
LISTED = re.search(r"^dependencies = \[(.*?)^\]", TEXT, re.MULTILINE | re.DOTALL)

for name, version in re.findall(r'"([\w-]+)>=([\w.]+)', LISTED[1]):
    if name != "torch":
        print(f"{name}=={version}")

"""What a cell's child does instead of running it: it copies what an earlier campaign stored of it, in the folder that CELLS names."""

import json
import os
import shutil
from pathlib import Path


def main(folder: Path) -> int:
    stored = (
        Path(os.environ["CELLS"]) / json.loads((folder / "task.json").read_text())["task"]["key"]
    )
    if not stored.is_dir():
        from validate.tasks import child

        return child.main(folder)
    shutil.copytree(stored, folder, dirs_exist_ok=True)
    return 0

"""An FMU of ours with an edited modelDescription.xml: what offers less, or says other names."""

import re
import zipfile
from collections.abc import Callable
from pathlib import Path


def edited(source: Path, target: Path, change: Callable[[str], str]) -> Path:
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for item in old.infolist():
            data = old.read(item)
            if item.filename == "modelDescription.xml":
                text = data.decode("utf-8")
                data = change(text).encode("utf-8")
                assert data.decode("utf-8") != text, "the edit changed nothing"
            new.writestr(item, data)
    return target


def without(element: str) -> Callable[[str], str]:
    return lambda text: re.sub(
        rf"<{element}\b[^>]*?(/>|>.*?</{element}>)", "", text, flags=re.DOTALL
    )


def renamed(*names: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        for name in names:
            text = text.replace(f'name="{name}"', f'name="hidden_{name}"')
        return text

    return change

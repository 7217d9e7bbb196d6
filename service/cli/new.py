"""``rbps new``: a model to begin with."""

from __future__ import annotations

import json
import os
import shlex
from pathlib import Path

from service.cli.ending import wrong

TEMPLATE = Path(__file__).with_name("template.py")


def write(file: Path, as_json: bool) -> None:
    """Write the template under the file's name; a file that is there is not written over."""
    shown = os.path.relpath(file)
    if file.suffix != ".py" or not file.stem.isidentifier():
        raise wrong(f"{shown}: a name such as pendulum.py is needed, of letters, digits and _")
    if file.exists():
        raise wrong(f"{shown}: there is such a file already; choose another name")
    if not file.absolute().parent.is_dir():
        raise wrong(f"{shown}: there is no folder {file.absolute().parent}")
    file.write_text(
        TEMPLATE.read_text(encoding="utf-8").replace("NAME", file.stem), encoding="utf-8"
    )
    if as_json:
        print(json.dumps({"file": str(file)}))
        return
    name = shlex.quote(shown)
    print(
        f"Written: {shown}. Next:\n  python {name}\n  rbps models {name}\n  rbps serve --model {name}"
    )

"""What the README shows runs, and prints what it says."""

import re
from pathlib import Path

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_every_python_block_runs(capsys):
    names = {}
    for block in BLOCKS:
        exec(compile(block, "README.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "Converged" in printed or "Iterations used up" in printed
    assert "(400, 2) (400, 2)" in printed
    assert "named step:flow" in printed
    assert names["found"].causes[0].parameters["step_flow_time"] == 1899.0

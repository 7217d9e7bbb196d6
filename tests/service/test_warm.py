"""Worker processes have compiled code for all that jobs call: the first job waits for no compiler.

Nor for a web framework, which neither a worker nor a command needs.
"""

import subprocess
import sys

import pytest

# in a process of its own, for other tests of this one may have compiled or loaded what is missing
SCRIPT = """
import ast
import sys
from pathlib import Path
import numpy as np
import service.attempt
import service.cli.diagnose
import service.cli.fit

web = {"fastapi", "starlette", "uvicorn"} & {*sys.modules}
assert not web, f"workers and commands load {web}, which takes as long as a small job"
from engine.compile_kernels import compiled_kernels, warm
from service import stages
from service.serializers import model
from service.validation import load
import engine

class Progress:
    def rows(self): return np.zeros((0, 0))
    def start(self, theta): pass
    def iteration(self, it): pass
    def step(self, k, message="", share=None): pass
    def left(self, task): return None
    def estimated(self, document): pass

def signatures():
    return {(name, str(one)) for name, all_ in compiled_kernels().items() for one in all_}

called = set()
for file in Path(engine.__file__).parent.rglob("*.py"):
    for node in ast.walk(ast.parse(file.read_text())) if file.parent.name != "kernels" else ():
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("engine.kernels."):
            called |= {node.module.split(".")[-1] + "." + one.name for one in node.names}
known = warm()
never = sorted(name for name in called & known.keys() if not known[name])
assert not never, f"called, and not compiled ahead: {never}"
before = signatures()
for name in ("mixed-4", "linear-2", "tanks"):
    estimate = model(engine.get_model(name)).example
    estimate["options"] = {"particles": 10, "iterations": 2, "seed": 1}
    estimate["parameters"]["free"] = [engine.get_model(name).parameter_names[0]]
    smooth = {"kind": "smooth", "model": name, "series": estimate["series"]}
    requests = [estimate, smooth]
    if name != "tanks":
        requests.append({"kind": "simulate", "model": name, "options": {"samples": 20}})
        requests.append(estimate | {"options": estimate["options"] | {"method": "ps-em"}})
    if name == "linear-2":
        requests.append(estimate | {"options": {"method": "rts-em", "iterations": 2}})
        y = [[float(np.sin(i))] for i in range(60)]
        diagnose = {"kind": "diagnose", "model": name, "series": [{"y": y}]}
        requests.append(diagnose | {"options": {"effects": ["step", "heavy-tails"], "max_effects": 1}})
    for request in requests:
        stages.run(load(request), 0, Progress())
        missing = sorted(signatures() - before)
        assert not missing, (name, request["kind"], missing)
"""


@pytest.mark.long
def test_no_kind_of_job_calls_a_kernel_that_is_not_compiled_ahead():
    subprocess.run([sys.executable, "-c", SCRIPT], check=True, timeout=900)

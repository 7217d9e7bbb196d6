"""``make demo``, as a newcomer runs it."""

import re
import subprocess
import sys

import pytest


@pytest.mark.slow
def test_the_demo_finds_what_is_known():
    done = subprocess.run(
        [sys.executable, "-m", "service.demo"], capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    assert "NAMED" in done.stdout
    assert "time 1899 year" in done.stdout
    assert re.search(r"step_flow_time = 1899\b", done.stdout)

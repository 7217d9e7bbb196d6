"""The image without a Docker engine: what its files say, and its commands run in a clean root."""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import pytest
import yaml

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
COMPOSE = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())


def instructions():
    """[(instruction, argument)], continued lines joined, comments dropped."""
    text = re.sub(r"^#.*\n", "", DOCKERFILE, flags=re.MULTILINE).replace("\\\n", " ")
    return [tuple(line.split(None, 1)) for line in text.splitlines() if line.strip()]


def test_dockerfile():
    words = [name for name, _ in instructions()]
    assert words.count("FROM") == 2
    final = instructions()[len(words) - words[::-1].index("FROM") :]
    assert ("USER", "rbps") in final
    assert any(name == "HEALTHCHECK" and "/livez" in argument for name, argument in final)
    assert not any(name == "ADD" for name in words)
    assert all(":" in argument for name, argument in instructions() if name == "FROM")
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    for name, argument in instructions():
        if name == "COPY" and "--from" not in argument:
            for source in argument.split()[:-1]:
                assert (ROOT / source).exists(), source
                assert f"!{source}" in ignored


def test_compose():
    services = COMPOSE["services"]
    assert [name for name, one in services.items() if "profiles" not in one] == ["service"]
    for name, one in services.items():
        if one["image"] == "rbps":
            assert one["read_only"], name
            assert one["cap_drop"] == ["ALL"]
        for port in one.get("ports", ()):
            assert port.startswith("127.0.0.1:"), "published beyond this machine without keys"


@pytest.mark.slow
def test_the_commands_of_each_stage_in_a_clean_root(tmp_path, free_ports):
    """RUN lines of the build stage with paths under tmp_path, then the entry point."""
    src, opt, tmp = tmp_path / "src", tmp_path / "opt", tmp_path / "tmp"
    for folder in (src, opt, tmp):
        folder.mkdir()
    env = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "EXTRAS": ""}
    env |= {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    stage = 0
    for name, argument in instructions():
        stage += name == "FROM"
        if stage > 1:
            break
        if name == "COPY":
            *sources, _ = argument.split()
            for source in sources:
                whole = ROOT / source
                if whole.is_dir():
                    shutil.copytree(
                        whole, src / source, ignore=shutil.ignore_patterns("__pycache__"),
                        dirs_exist_ok=True,
                    )  # fmt: skip
                else:
                    shutil.copy(whole, src / source)
        elif name == "RUN":
            command = argument.replace("/opt/rbps", f"{opt}/rbps").replace("cd /", f"cd {tmp}")
            command = command.replace("python -m venv", f"{sys.executable} -m venv", 1)
            subprocess.run(["sh", "-c", command], cwd=src, env=env, check=True)
    kernels = tmp / "kernels"
    entry = (ROOT / "docker" / "entrypoint").read_text().replace("/opt/rbps", f"{opt}/rbps")
    (tmp / "entrypoint").write_text(entry)
    port = free_ports()
    env |= {"NUMBA_CACHE_DIR": str(kernels), "RBPS_STATE_DIR": str(tmp / "state")}
    env |= {"RBPS_PORT": str(port), "PYTHONDONTWRITEBYTECODE": "1"}
    compiled = {path.name for path in (opt / "rbps" / "kernels").rglob("*.nbc")}
    assert compiled
    command = ["sh", str(tmp / "entrypoint"), f"{opt}/rbps/bin/python", "-m", "service"]
    process = subprocess.Popen(command, cwd=tmp, env=env)
    try:
        for _ in range(300):
            try:
                urlopen(f"http://127.0.0.1:{port}/livez", timeout=4).close()
                break
            except OSError:
                time.sleep(0.1)
        else:
            raise AssertionError("the service did not start")
        time.sleep(3.0)
        assert {path.name for path in kernels.rglob("*.nbc")} == compiled  # nothing compiled again
    finally:
        process.terminate()
        process.wait(30)

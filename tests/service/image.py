"""A Dockerfile carried out without an engine: each stage in a clean root, then run as it would be.

What is understood is what ``docker/Dockerfile`` uses. A stage starts from a copy of a minimal Debian
root; ``RUN`` is a ``chroot`` with nothing of this machine's environment; packages come from a folder
of wheels. A container is a process in namespaces of its own (mounts, network, processes) whose root
is mounted read-only, without capabilities, as the image's user.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PATH = "/usr/local/bin:/usr/local/sbin:/usr/sbin:/usr/bin:/sbin:/bin"


def instructions(text: str) -> list[tuple[str, str]]:
    """[(instruction, argument)], continued lines joined, comments dropped."""
    text = re.sub(r"^#.*\n", "", text, flags=re.MULTILINE).replace("\\\n", " ")
    return [
        (words[0], words[1].strip())
        for line in text.splitlines()
        if (words := line.split(None, 1)) and len(words) == 2
    ]


@dataclass
class Image:
    """A root folder and how to start it."""

    root: Path
    env: dict[str, str] = field(default_factory=lambda: {"PATH": PATH})
    workdir: str = "/"
    user: str = "root"
    entrypoint: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)
    volumes: list[str] = field(default_factory=list)
    healthcheck: list[str] = field(default_factory=list)

    def inside(self, path: str) -> Path:
        """The path as seen from outside."""
        return self.root / (Path(self.workdir) / path).relative_to("/")


def build(
    dockerfile: str, context: Path, base: Path, folder: Path, arguments: dict[str, str]
) -> Image:
    """Carry out all stages; each FROM is a copy of ``base``. ``arguments`` are --build-arg.

    Raises CalledProcessError where a command fails.
    """
    stages: dict[str, Image] = {}
    image = Image(base)
    build_env: dict[str, str] = {}
    for name, argument in instructions(dockerfile):
        argument = (
            _expanded(argument, image.env) if name not in ("RUN", "CMD", "ENTRYPOINT") else argument
        )
        match name:
            case "FROM":
                words = argument.split()
                image = Image(folder / f"stage-{len(stages)}")
                subprocess.run(
                    ["cp", "-a", "--reflink=auto", str(base), str(image.root)], check=True
                )
                stages[words[2] if len(words) > 2 else str(len(stages))] = image
                build_env = {}
            case "ARG":
                key, _, default = argument.partition("=")
                build_env[key] = arguments.get(key, default.strip('"'))
            case "ENV":
                image.env |= dict(word.split("=", 1) for word in shlex.split(argument))
            case "WORKDIR":
                image.workdir = argument
                image.inside(".").mkdir(parents=True, exist_ok=True)
            case "COPY":
                _copy(argument, image, stages, context)
            case "RUN":
                env = image.env | build_env | {"HOME": "/root", "PIP_NO_INDEX": "1"}
                _chroot(image, ["sh", "-c", argument], env | {"PIP_FIND_LINKS": "/wheels"})
            case "USER":
                image.user = argument
            case "VOLUME":
                image.volumes.append(argument)
            case "ENTRYPOINT":
                image.entrypoint = json.loads(argument)
            case "CMD":
                image.command = json.loads(argument)
            case "HEALTHCHECK":
                image.healthcheck = json.loads(argument.partition(" CMD ")[2])
            case "EXPOSE":
                pass
            case _:
                raise ValueError(f"{name} is not understood")
    return image


def _expanded(text: str, env: dict[str, str]) -> str:
    return re.sub(r"\$(\w+)", lambda found: env.get(found[1], ""), text)


def _copy(argument: str, image: Image, stages: dict[str, Image], context: Path) -> None:
    words = argument.split()
    root = context
    if words[0].startswith("--from="):
        root = stages[words.pop(0).removeprefix("--from=")].root
    *sources, target = words
    for source in sources:
        found, to = root / source.lstrip("/"), image.inside(target)
        if found.is_dir():
            ignore = shutil.ignore_patterns("__pycache__") if root == context else None
            shutil.copytree(found, to, symlinks=True, ignore=ignore, dirs_exist_ok=True)
        else:
            to = to / found.name if target.endswith("/") else to
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(found, to)


def _chroot(image: Image, command: list[str], env: dict[str, str]) -> None:
    shell = f"cd {image.workdir} && exec {shlex.join(command)}"
    words = [f"{key}={value}" for key, value in env.items()]
    subprocess.run(
        ["chroot", str(image.root), "/usr/bin/env", "-i", *words, "/bin/sh", "-c", shell],
        check=True,
    )


class Container:
    """A running image: read-only root, tmpfs on /tmp, the image's volumes, no capabilities."""

    def __init__(
        self,
        image: Image,
        volumes: Path,
        command: list[str] | None = None,
        env: dict[str, str] | None = None,
        network: Container | None = None,
        log: Any = None,
    ) -> None:
        self.image, self.env = image, image.env | (env or {})
        account = [line.split(":") for line in (image.root / "etc/passwd").read_text().splitlines()]
        self.uid, self.gid, self.home = next(
            (int(a[2]), int(a[3]), a[5]) for a in account if a[0] == image.user
        )
        root = str(image.root)
        script = ["set -e", f"mount --bind {root} {root}", f"mount -o remount,bind,ro {root}"]
        for place in ("tmp", "dev/shm"):
            script.append(f"mount -t tmpfs tmpfs {root}/{place} -o mode=1777")
        script.append(f"mount -t proc proc {root}/proc")
        for volume in image.volumes:
            outside = volumes / volume.strip("/").replace("/", "-")
            if not outside.exists():  # as an engine does: what the image has there, and its owner
                shutil.copytree(image.root / volume.strip("/"), outside)
                os.chown(outside, self.uid, self.gid)
            script.append(f"mount --bind {outside} {root}{volume}")
        if network is None:
            script.append("ip link set lo up")
        words = [*image.entrypoint, *(command or image.command)]
        script.append("exec " + shlex.join(["chroot", root, *self._as_user(words)]))
        unshare = ["unshare", "--mount", "--pid", "--fork", "--kill-child"]
        unshare += ["--net"] if network is None else []
        join = ["nsenter", "--target", str(network.pid), "--net"] if network else []
        self.process = subprocess.Popen(
            [*join, *unshare, "sh", "-c", "\n".join(script)], stdout=log, stderr=log
        )

    def _as_user(self, words: list[str]) -> list[str]:
        drop = ["setpriv", f"--reuid={self.uid}", f"--regid={self.gid}", "--clear-groups"]
        drop += ["--no-new-privs", "--bounding-set=-all", "--inh-caps=-all"]
        env = {"HOME": self.home} | self.env
        return [*drop, "env", "-i", *(f"{k}={v}" for k, v in env.items()), *words]

    @property
    def pid(self) -> int:
        """The first process within, as seen from here."""
        end = time.monotonic() + 60
        while time.monotonic() < end:
            try:
                children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
                if found := children.read_text().split():
                    return int(found[0])
            except FileNotFoundError:
                break
            time.sleep(0.05)
        raise RuntimeError("the container has ended")

    def execute(self, words: list[str]) -> subprocess.CompletedProcess[str]:
        """Run a command within, as its user; exit code and output."""
        enter = [
            "nsenter",
            "--target",
            str(self.pid),
            "--mount",
            "--net",
            "--pid",
            "--root",
            "--wd",
        ]
        return subprocess.run(
            [*enter, *self._as_user(words)], capture_output=True, text=True, check=False
        )

    def wait_until_healthy(self, seconds: float = 120.0) -> None:
        """Return when the image's health check succeeds."""
        end = time.monotonic() + seconds
        while (found := self.execute(self.image.healthcheck)).returncode:
            if time.monotonic() > end or self.process.poll() is not None:
                raise AssertionError(f"unhealthy: {found.stderr[-500:]}")
            time.sleep(0.2)

    def stop(self) -> int:
        """SIGTERM to the first process within; its exit code."""
        if self.process.poll() is None:
            os.kill(self.pid, 15)
        return self.process.wait(60)

"""The image as an engine makes it: built by ``buildah``, which needs no daemon, and run as it would be.

The base is a minimal Debian root with Python, in place of the official Python image; packages come from a
folder of wheels. A container is a process in namespaces of its own (mounts, network, processes) whose
root is the image's, mounted read-only, without capabilities, as the image's user.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.patience import eventually


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
    """A root folder and how to start it, as the image says."""

    root: Path
    env: dict[str, str]
    user: str
    entrypoint: list[str]
    command: list[str]
    volumes: list[str]
    healthcheck: list[str]


class Buildah:
    """Images and containers in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        places = ["--root", str(folder / "storage"), "--runroot", str(folder / "run")]
        self._command = ["buildah", "--storage-driver", "vfs", *places]

    def __call__(self, *words: str | Path) -> str:
        """Carry out a command; what it prints. Raises CalledProcessError with its errors shown."""
        command = [*self._command, *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (
            f"{shlex.join(command)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
        )
        return done.stdout.strip()


def build(context: Path, base: Path, wheels: Path, folder: Path) -> Image:
    """Build ``docker/Dockerfile`` on a root folder that becomes its base image."""
    buildah = Buildah(folder)
    scratch = buildah("from", "scratch")
    buildah("add", "--quiet", scratch, base, "/")
    buildah("commit", "--quiet", scratch, "base")
    buildah("rm", scratch)
    buildah(
        "build", "--isolation", "chroot", "--format", "docker", "--layers=false", "--pull-never",
        "--build-arg", "BASE=localhost/base", "--volume", f"{wheels}:/wheels:ro",
        "--file", context / "docker/Dockerfile", "--tag", "rbps", context,
    )  # fmt: skip
    config = json.loads(buildah("inspect", "--type", "image", "rbps"))["Docker"]["config"]
    container = buildah("from", "--pull-never", "localhost/rbps")
    return Image(
        root=Path(buildah("mount", container)),
        env=dict(word.split("=", 1) for word in config["Env"]),
        user=config["User"],
        entrypoint=config["Entrypoint"],
        command=config["Cmd"],
        volumes=list(config["Volumes"]),
        healthcheck=config["Healthcheck"]["Test"][1:],
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
        mounts: dict[Path, str] | None = None,
        entrypoint: list[str] | None = None,
    ) -> None:
        self.image, self.env = image, image.env | (env or {})
        account = [line.split(":") for line in (image.root / "etc/passwd").read_text().splitlines()]
        self.uid, self.gid = map(int, image.user.split(":"))
        self.home = next(a[5] for a in account if int(a[2]) == self.uid)
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
        for outside, inside in (mounts or {}).items():
            script.append(f"mount --bind {outside} {root}{inside}")
        if network is None:
            script.append("ip link set lo up")
        start = image.entrypoint if entrypoint is None else entrypoint
        words = [*start, *(image.command if command is None else command)]
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
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        try:
            return int(eventually(lambda: children.read_text().split())[0])
        except FileNotFoundError:
            raise RuntimeError("the container has ended") from None

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

        def healthy() -> bool:
            found = self.execute(self.image.healthcheck)
            assert self.process.poll() is None, f"unhealthy: {found.stderr[-500:]}"
            return not found.returncode

        eventually(healthy, seconds, lambda: time.sleep(0.2))

    def stop(self) -> int:
        """SIGTERM to the first process within; its exit code."""
        if self.process.poll() is None:
            os.kill(self.pid, 15)
        return self.process.wait(60)

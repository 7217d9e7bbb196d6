"""The image: what its files say; and built by buildah and started, where that and debootstrap are."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from service.settings import Settings
from tests.service.image import Container, build, instructions

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docker" / "Dockerfile").read_text()
DOCKERFILE = instructions(TEXT)
COMPOSE = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())
SERVICES = COMPOSE["services"]
PINNED = r"[\w./-]+:[\w.-]*\d[\w.-]*@sha256:[0-9a-f]{64}"


# ---- what a linter would say ----------------------------------------------------------------


def last_stage():
    names = [name for name, _ in DOCKERFILE]
    return DOCKERFILE[len(names) - names[::-1].index("FROM") - 1 :]


def test_dockerfile():
    known = {
        "FROM", "ENV", "WORKDIR", "COPY", "ARG", "RUN", "USER", "VOLUME", "EXPOSE", "HEALTHCHECK",
        "ENTRYPOINT", "CMD", "STOPSIGNAL",
    }  # fmt: skip
    assert {name for name, _ in DOCKERFILE} <= known
    assert TEXT.startswith("# syntax=docker/dockerfile:1\n")
    bases = [argument.split()[0] for name, argument in DOCKERFILE if name == "FROM"]
    assert bases == ["${BASE}", "${BASE}"]
    assert re.fullmatch(rf"BASE={PINNED}", dict(DOCKERFILE[:1])["ARG"])
    folders, commands = (
        [argument for one, argument in DOCKERFILE if one == name] for name in ("WORKDIR", "RUN")
    )
    assert folders
    assert all(folder.startswith("/") for folder in folders)
    assert commands
    assert not re.search(r"\b(sudo|curl|wget|apt-get upgrade)\b", "\n".join(commands))
    final = last_stage()
    for name in ("ENTRYPOINT", "CMD"):
        (words,) = [json.loads(argument) for one, argument in final if one == name]
        assert words
        assert all(isinstance(word, str) for word in words)
    (check,) = [argument for name, argument in final if name == "HEALTHCHECK"]
    assert "/livez" in " ".join(json.loads(check.partition(" CMD ")[2]))
    after_user = [name for name, _ in final][[name for name, _ in final].index("USER") :]
    assert ("USER", "10001:10001") in final, "by number, which a cluster can check"
    assert not {"RUN", "COPY"} & set(after_user)


def test_only_what_the_image_needs_is_sent_to_the_engine():
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    assert ignored[0] == "*"
    for name, argument in DOCKERFILE:
        if name == "COPY" and "--from" not in argument:
            for source in argument.split()[:-1]:
                assert (ROOT / source).exists(), source
                assert f"!{source}" in ignored


def test_every_package_is_known_by_its_hash():
    """All that the project and its cluster need, at the versions that the tests run with."""
    text = (ROOT / "docker" / "requirements.txt").read_text()
    entries = re.split(r"\n(?=[a-z])", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE).strip())
    pinned = {}
    for entry in entries:
        name, version = re.match(r"([\w.-]+)==([\w.+-]+)", entry).groups()
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), name
        pinned[normal(name)] = version
    constraints = dict(
        line.split("==")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    )
    known = {normal(name): version for name, version in constraints.items()}
    assert {name: known[name] for name in pinned if name in known} == {
        name: version for name, version in pinned.items() if name in known
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    asked = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
    asked += [*extras["postgres"], *(one for one in extras["cluster"] if "rbps[" not in one)]
    assert {normal(re.match(r"[\w.-]+", one)[0]) for one in asked} <= set(pinned)
    assert "--require-hashes" in TEXT


def normal(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def test_compose_profiles_and_guards():
    assert set(COMPOSE) <= {"services", "volumes", "x-image", "x-tls"}
    plain = [name for name, one in SERVICES.items() if "profiles" not in one]
    assert plain == ["service"]
    assert {p for one in SERVICES.values() for p in one.get("profiles", ())} == {"cluster"}
    known = {
        "build", "image", "init", "read_only", "tmpfs", "cap_drop", "security_opt", "restart", "user",
        "environment", "ports", "volumes", "profiles", "healthcheck", "command", "depends_on",
        "mem_limit", "pids_limit", "cpus", "stop_grace_period", "entrypoint",
    }  # fmt: skip
    for name, one in SERVICES.items():
        assert set(one) <= known, name
        assert one["restart"] == ("no" if name == "certificates" else "unless-stopped")
        assert one["read_only"], name
        assert one["cap_drop"] == ["ALL"]
        assert one["security_opt"] == ["no-new-privileges:true"]
        assert {"mem_limit", "pids_limit", "cpus", "stop_grace_period"} <= set(one), name
        assert all(re.search(r":size=\d+[mg]\b", place) for place in one["tmpfs"]), name
        if one["image"] == "rbps":
            assert (ROOT / "docker" / one["build"]["context"] / one["build"]["dockerfile"]).exists()
        else:
            assert re.fullmatch(PINNED, one["image"])
            assert re.fullmatch(r"[1-9]\d*:[1-9]\d*", one["user"])
        for port in one.get("ports", ()):
            assert port.startswith("127.0.0.1:"), "published beyond this machine without keys"
    text = (ROOT / "docker" / "compose.yaml").read_text()
    assert "PASSWORD:-" not in text, "a password that everybody knows"


def test_the_cluster_s_members_show_certificates():
    for name in ("scheduler", "worker", "front"):
        env = SERVICES[name]["environment"]
        assert env["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] == "True"
        for role in ("SCHEDULER", "WORKER", "CLIENT"):
            assert env[f"DASK_DISTRIBUTED__COMM__TLS__{role}__CERT"] == "/tls/cert.pem"
        assert "tls:/tls:ro" in SERVICES[name]["volumes"]


def test_compose_names_what_there_is():
    for name, one in SERVICES.items():
        for volume in one.get("volumes", ()):
            assert volume.split(":")[0] in COMPOSE["volumes"], name
        for other, how in one.get("depends_on", {}).items():
            has_check = "healthcheck" in SERVICES[other] or SERVICES[other]["image"] == "rbps"
            assert how["condition"] != "service_healthy" or has_check
        values = {key: re.sub(r"\$\{\w+:\?[^}]*\}", "secret", str(value))
                  for key, value in one.get("environment", {}).items()}  # fmt: skip
        Settings.from_env(values)  # no unknown RBPS_ variable
        for text in [*values.values(), *(one.get("command") or ())]:
            for host in re.findall(r"://(?:[^@/]*@)?([a-z]+)", text):
                assert host in SERVICES, f"{name}: {host}"


# ---- the commands themselves ----------------------------------------------------------------


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """The image, built in a folder of its own.

    The environment variable DEBIAN_ROOT may name a minimal root, else debootstrap makes one.
    """
    tools = ("buildah", "chroot", "unshare", "nsenter", "mount", "debootstrap")
    if missing := [name for name in tools if not shutil.which(name)]:
        pytest.skip(f"not installed: {', '.join(missing)}")
    if os.getuid() != 0:
        pytest.skip("only root can mount the image's root")
    folder = tmp_path_factory.mktemp("image")
    base = folder / "base"
    if given := os.environ.get("DEBIAN_ROOT"):
        subprocess.run(["cp", "-a", given, str(base)], check=True)
    else:
        debian(base)
    python = base / "usr/local/bin/python"  # what the official Python image has
    python.unlink(missing_ok=True)
    python.symlink_to("/usr/bin/python3")
    (base / "etc/pip.conf").write_text("[global]\nno-index = true\nfind-links = /wheels\n")
    wheels(folder / "wheels")
    made = build(ROOT, base, folder / "wheels", folder)
    yield made
    subprocess.run(["umount", "-l", str(made.root)], check=False, capture_output=True)
    shutil.rmtree(folder)


def debian(folder):
    format_ = ["--format", "$(REPO_URI) $(CODENAME)"]
    targets = subprocess.run(
        ["apt-get", "indextargets", *format_], capture_output=True, text=True, check=True
    )
    mirror = next(
        line.split()[0] for line in targets.stdout.splitlines() if line.endswith(" bookworm")
    )
    packages = "--include=python3,python3-venv,ca-certificates"
    command = ["debootstrap", "--variant=minbase", packages, "bookworm", str(folder), mirror]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def wheels(folder):
    """All that pip will ask for within, checked as it will be there."""
    command = [sys.executable, "-m", "pip", "download", "-qq", "--dest", str(folder), "--no-deps"]
    command += ["--only-binary=:all:", "--python-version=3.11", "--require-hashes"]
    subprocess.run([*command, "-r", str(ROOT / "docker" / "requirements.txt")], check=True)


@pytest.fixture
def start(image, tmp_path):
    started: list[Container] = []

    def start_(**more):
        volumes = tmp_path / "volumes"
        volumes.mkdir(exist_ok=True)
        with (tmp_path / f"log-{len(started)}").open("wb") as log:
            started.append(Container(image, volumes, log=log, **more))
        return started[-1]

    yield start_
    for container in reversed(started):
        container.stop()


CALL = """
import json, sys, time
from urllib.request import Request, urlopen
def ask(path, body=None):
    data = None if body is None else json.dumps(body).encode()
    with urlopen(Request("http://127.0.0.1:8000" + path, data, {"Content-Type": "application/json"})) as answer:
        return json.load(answer)
"""
RUN = (
    CALL
    + """
model = ask("/models/mixed-4")
job = ask("/jobs", model["example"] | {"options": {"iterations": 5, "particles": 20}})
for _ in range(1200):
    status = ask("/jobs/" + job["jobID"])
    if status["status"] not in ("accepted", "running"):
        break
    time.sleep(0.1)
print(json.dumps(status))
"""
)


def python(container, text):
    done = container.execute(["python", "-c", text])
    assert done.returncode == 0, done.stderr
    return done.stdout


def compiled(container, folder):
    found = python(
        container, f"import glob; print(*glob.glob('{folder}/**/*.nbc', recursive=True))"
    )
    return {Path(path).name for path in found.split()}


@pytest.mark.slow
def test_the_image_runs_as_nobody_on_a_read_only_root_and_starts_warm(image, start):
    container = start()
    container.wait_until_healthy()
    facts = json.loads(python(container, """
import json, os
def writable(path):
    try:
        open(path + "/x", "w").close()
    except OSError:
        return False
    return True
status = open("/proc/self/status").read()
print(json.dumps({
    "uid": os.getuid(), "groups": os.getgroups(),
    "capabilities": [line.split()[1] for line in status.splitlines() if line.startswith("Cap")],
    "writable": {p: writable(p) for p in ("/", "/opt/rbps", "/usr/local/bin", "/tmp", "/var/lib/rbps")},
}))
"""))  # fmt: skip
    assert facts["uid"] == 10001
    assert set(facts["capabilities"]) == {"0000000000000000"}
    assert facts["writable"] == {
        "/": False, "/opt/rbps": False, "/usr/local/bin": False, "/tmp": True, "/var/lib/rbps": True,
    }  # fmt: skip
    page = "Request('http://127.0.0.1:8000/', headers={'Accept': 'text/html'})"
    html = python(container, CALL + f"print(urlopen({page}).read().decode())")
    assert "<html" in html
    before = compiled(container, "/opt/rbps/kernels")
    assert before
    job = json.loads(python(container, RUN))
    assert job["status"] == "successful", job["message"]
    assert compiled(container, "/tmp/kernels") == before  # nothing had to be compiled
    assert container.stop() == 0

    again = start()  # what a volume is for
    again.wait_until_healthy()
    listed = json.loads(python(again, CALL + "print(json.dumps(ask('/jobs')))"))["jobs"]
    assert [one["jobID"] for one in listed] == [job["jobID"]]


@pytest.mark.slow
def test_the_cluster_of_compose(image, start, tmp_path):
    """Certificates, scheduler, workers and service with the commands and variables of compose.yaml."""
    hosts = image.root / "etc/hosts"
    hosts.write_text("127.0.0.1 localhost scheduler database\n")
    tls = tmp_path / "tls"
    tls.mkdir(mode=0o700)
    os.chown(tls, 10001, 10001)
    mounts = {tls: "/tls"}
    one = SERVICES["certificates"]
    made = start(entrypoint=one["entrypoint"], command=[], mounts=mounts)
    assert made.process.wait(60) == 0
    assert {file.name for file in tls.iterdir()} == {"ca.pem", "cert.pem", "key.pem"}
    one = SERVICES["scheduler"]
    scheduler = start(command=one["command"], env=one["environment"], mounts=mounts)
    check = one["healthcheck"]["test"][1:]
    for _ in range(600):
        if not scheduler.execute(check).returncode:
            break
    else:
        raise AssertionError("the scheduler is not healthy")
    one = SERVICES["worker"]
    start(command=one["command"], env=one["environment"], network=scheduler, mounts=mounts)
    env = dict(SERVICES["front"]["environment"])
    env["RBPS_DATABASE_URL"] = "sqlite:////var/lib/rbps/cluster.sqlite"  # one machine, one volume
    front = start(env=env, network=scheduler, mounts=mounts)
    front.wait_until_healthy()
    job = json.loads(python(front, RUN))
    assert job["status"] == "successful", job["message"]
    stranger = "import distributed; distributed.Client('tcp://scheduler:8786', timeout=5)"
    assert front.execute(["python", "-c", stranger]).returncode != 0

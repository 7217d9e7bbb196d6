"""How large the packages are, at several commits: ``python -m tests.benchmarks.bench_size COMMIT ...``.

Of each commit: lines of code in ``engine`` and ``service`` (what is neither blank, nor a comment, nor a
docstring), without studies and benchmarks, which were once part of ``engine``; the wheel; and the processor
time of ``import engine``, by turns, the least of several. Writes ``results/size.md``.
"""

from __future__ import annotations

import ast
import io
import resource
import subprocess
import sys
import tempfile
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parent / "results"
IMPORTS = 7
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_lines(source: str) -> int:
    """Lines that hold code."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            docstrings.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def package_lines(folder: Path) -> int:
    """Lines of code of a package, apart from studies and benchmarks."""
    files = (one for one in folder.rglob("*.py") if not {"studies", "benchmarks"} & {*one.parts})
    return sum(code_lines(one.read_text()) for one in files)


def unpacked(commit: str, folder: Path) -> Path:
    """The files of a commit in a folder of their own."""
    folder.mkdir()
    archive = subprocess.run(
        ["git", "archive", commit, "engine", "service", "pyproject.toml", "README.md", "LICENSE"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    ).stdout
    subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
    return folder


def wheel_kilobytes(folder: Path) -> float:
    """The size of the wheel that is built from a folder."""
    built = folder / "built"
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(built), "."]
    subprocess.run(command, cwd=folder, check=True)
    (wheel,) = built.glob("*.whl")
    return wheel.stat().st_size / 1e3


def import_seconds(folder: Path) -> float:
    """Processor seconds of a process that imports the engine of a folder and ends."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", "import engine"], cwd=folder, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def described(commit: str) -> str:
    """Its short name, date and subject."""
    command = ["git", "log", "-1", "--format=`%h` | %as | %s", commit]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def main(commits: list[str]) -> None:
    """Measure all commits and write the table."""
    with tempfile.TemporaryDirectory() as temporary:
        folders = [unpacked(one, Path(temporary) / str(k)) for k, one in enumerate(commits)]
        seconds = [[import_seconds(folder) for folder in folders] for _ in range(IMPORTS)]
        rows = [
            [
                described(commit).strip().replace("\n", ""),
                str(package_lines(folder / "engine")),
                str(package_lines(folder / "service")),
                f"{wheel_kilobytes(folder):.0f}",
                f"{min(one[k] for one in seconds):.2f}",
            ]
            for k, (commit, folder) in enumerate(zip(commits, folders, strict=True))
        ]
    head = "commit | date | subject | engine, lines | service, lines | wheel, kB | import engine, s"
    lines = [f"| {head} |", f"|{' --- |' * 7}", *(f"| {' | '.join(row)} |" for row in rows)]
    title, *rest = (__doc__ or "").strip().splitlines()
    text = "\n".join(["# Size of the packages\n", title, *rest, "", *lines, ""])
    (RESULTS / "size.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])

"""`get_ode` installs files that nobody else may write."""

import os
import subprocess
from pathlib import Path

import pytest

import imolo_backends.engines

SCRIPT = Path(imolo_backends.engines.__file__).with_name("get_ode")
FAKES = {
    "apt-get": "touch python3-pyode.deb",
    # As careless as can be.
    "dpkg": """
mkdir -p "$3"/usr/{bin,lib/python3/dist-packages/Py3ODE-1.egg-info,lib/x86-linux-gnu}
cd "$3"/usr/lib
touch python3/dist-packages/{ode.so,Py3ODE-1.egg-info/PKG-INFO} x86-linux-gnu/lib{ode.so.8,ccd.so.2}
printf '#!/bin/sh\n' >../bin/patchelf
chmod -R 777 "$3"/usr
""",
}
PYTHON = """
case "$2" in
  *EXT_SUFFIX*) echo .so ;;
  *platlib*) echo "$PLATLIB" ;;
esac
"""


@pytest.mark.parametrize("mask", [0o000, 0o077])
def test_what_is_installed_is_readable_by_all_and_writable_by_its_owner_alone(tmp_path: Path, mask: int) -> None:
    places = {name: tmp_path / name for name in (".venv/bin", "fakes", "platlib")}
    for place in places.values():
        place.mkdir(parents=True)
    places["platlib"].chmod(0o755)
    programs = {places["fakes"] / name: text for name, text in FAKES.items()} | {places[".venv/bin"] / "python": PYTHON}
    for path, text in programs.items():
        path.write_text(f"#!/usr/bin/env bash\n{text}", encoding="utf-8")
        path.chmod(0o755)
    subprocess.run(
        ["bash", "-c", f"umask {mask:03o}; exec bash {SCRIPT} .venv/bin/python"],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{places['fakes']}:{os.environ['PATH']}", "PLATLIB": str(places["platlib"])},
        check=True,
    )
    installed = list(places["platlib"].rglob("*"))
    assert {path.name for path in installed if path.is_file()} == {"ode.so", "libode.so.8", "libccd.so.2", "PKG-INFO"}
    for path in installed:
        assert path.stat().st_mode & 0o777 == (0o755 if path.is_dir() else 0o644), path

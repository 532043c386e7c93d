"""Fetch the web parts that the console ships, check them, copy them byte for byte: ``python -m tools.vendor_web``.

A folder's ``VENDOR.json`` says what is wanted (name, version, files). The ordinary ``npm pack`` fetches each package;
what npm says of it (integrity) and each file's sha256 are written back, so that a test can check the files offline.
Run again with a known integrity, a package that differs from it is refused.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from common.errors import EXIT_OK, EXIT_REFUSED

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (ROOT / "services/console/static/vendor", ROOT / "tests/browser/vendor")
_NPM_S = 120.0

Plain = dict[str, Any]


class VendorError(Exception):
    """A package that can't be fetched, or isn't the one that was checked before."""


def main() -> int:
    """Renew every folder; the exit code."""
    try:
        for folder in FOLDERS:
            renew(folder)
    except VendorError as error:
        print(f"vendor_web: {error}", file=sys.stderr)
        return EXIT_REFUSED
    return EXIT_OK


def renew(folder: Path) -> None:
    """Fetch, check and copy what ``folder``'s VENDOR.json lists, and write back what was found."""
    manifest = json.loads((folder / "VENDOR.json").read_text())
    licences = folder / "LICENSES"
    licences.mkdir(exist_ok=True)
    for package in manifest["packages"]:
        with tempfile.TemporaryDirectory() as place:
            tarball = fetch(package, Path(place))
            with tarfile.open(tarball) as archive:
                _copy(package, archive, folder)
            print(f"{package['name']} {package['version']}: {', '.join(package['sha256'])}")
    (folder / "VENDOR.json").write_text(json.dumps(manifest, indent=2) + "\n")


def fetch(package: Plain, place: Path) -> Path:
    """Pack one package into ``place`` and check its integrity against npm's word and the one known from before."""
    wanted = f"{package['name']}@{package['version']}"
    command = ["npm", "pack", wanted, "--json", "--pack-destination", str(place)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_NPM_S, check=True, cwd=place)
    except FileNotFoundError as error:
        raise VendorError("npm is not installed; it is needed only to renew the web parts") from error
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        raise VendorError(f"'npm pack {wanted}' failed: {error}") from error
    told = json.loads(done.stdout)[0]
    tarball = place / str(told["filename"])
    integrity = "sha512-" + base64.b64encode(hashlib.sha512(tarball.read_bytes()).digest()).decode()
    if integrity != told["integrity"] or package.get("integrity", integrity) != integrity:
        raise VendorError(f"{wanted} is not the package that was checked before: {integrity}")
    package["tarball"] = f"{package['name']}/-/{tarball.name.removeprefix(_scope(package['name']))}"
    package["integrity"] = integrity
    return tarball


def _scope(name: str) -> str:
    """How npm begins the file name of a scoped package (``@preact/signals`` → ``preact-``)."""
    return name[1 : name.index("/")] + "-" if name.startswith("@") else ""


def _copy(package: Plain, archive: tarfile.TarFile, folder: Path) -> None:
    """Write the package's files, its sprite and its licence; note their sha256."""
    licence = "LICENSES/" + package["name"].replace("/", "-").removeprefix("@") + ".txt"
    wanted = {**package.get("files", {}), licence: package["licence_file"]}
    written = {name: _read(archive, source) for name, source in wanted.items()}
    for name, icons in package.get("sprite", {}).items():
        written[name] = sprite({icon: _read(archive, f"icons/{icon}.svg").decode() for icon in icons}).encode()
    for name, content in written.items():
        (folder / name).write_bytes(content)
    package["sha256"] = {name: hashlib.sha256(content).hexdigest() for name, content in written.items()}


def _read(archive: tarfile.TarFile, name: str) -> bytes:
    try:
        file = archive.extractfile(f"package/{name}")
    except KeyError as error:
        raise VendorError(f"the package has no {name}") from error
    if file is None:
        raise VendorError(f"{name} is no file")
    return file.read()


def sprite(icons: dict[str, str]) -> str:
    """One SVG with a symbol an icon, so that a page fetches one file."""
    symbols = []
    for name, svg in icons.items():
        body = re.sub(r"^.*?<svg[^>]*>|</svg>\s*$", "", svg, flags=re.DOTALL)
        symbols.append(f'<symbol id="{name}" viewBox="0 0 24 24">{" ".join(body.split())}</symbol>')
    return '<svg xmlns="http://www.w3.org/2000/svg">\n' + "\n".join(symbols) + "\n</svg>\n"


if __name__ == "__main__":
    sys.exit(main())

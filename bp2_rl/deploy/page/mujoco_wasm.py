"""MuJoCo's official build for browsers: a package of npm, fetched once, or given as a
file."""

import contextlib
import hashlib
import io
import shutil
import subprocess
import tarfile
import tempfile
import urllib.request
from pathlib import Path

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_bytes, write_bytes
from bp2_rl.base.processes import cache_folder

VERSION = "3.14.0"
SHA512 = {
    "mujoco.js": (
        "c0f6aa8da6db5930eea2eb630810809e390154789894e929ee5a1bf7a62286d1"
        "dfa7f4aa7ee19c0b5d50ca1b3b4cdba489c4006c49a9be66905ffe0186871430"
    ),
    "mujoco.wasm": (
        "74b30a35982f4890a078fdc7e2ddfb9e85a148691ab538d5ce7930a4d41b17d4"
        "c64562b5161a9fe85304707d61b6db02307b9fa939a89b279b43716354246eed"
    ),
}
"""Of the package's files that a page needs, as npm has published them."""
PACKAGE = f"@mujoco/mujoco@{VERSION}"
NETWORK = f"https://cdn.jsdelivr.net/npm/{PACKAGE}"
"""The folder of npm's packages that browsers load from; asked where npm is not
installed."""
LARGEST = 32 << 20  # bytes
PATIENCE = 60.0  # s, for which a silent network is waited for
Files = dict[str, bytes]


def mujoco_files(given: Path | None) -> tuple[bytes, bytes]:
    """Return mujoco.js and mujoco.wasm from the package's file: `given`, or from the
    cache, or else by npm or from the network.

    Raises:
        UserError: the files cannot be had, or are others than the pinned ones.
    """
    kept = cache_folder() / f"mujoco-wasm-{VERSION}"
    cached = all((kept / name).is_file() for name in SHA512)
    if given is not None:
        files = _unpacked(given)
    elif cached:
        files = {name: read_bytes(kept / name, LARGEST) for name in SHA512}
    else:
        files = _fetch()
    for name, pinned in SHA512.items():
        if hashlib.sha512(files.get(name, b"")).hexdigest() != pinned:
            raise UserError(
                f"{given or kept}: {name} is not that of npm's {PACKAGE}; remove it, or give the package with "
                "--mujoco-package FILE"
            )
    if given is None and not cached:
        with contextlib.suppress(OSError):  # then they are fetched again the next time
            kept.mkdir(parents=True, exist_ok=True)
            for name, content in files.items():
                write_bytes(kept / name, content)
    return files["mujoco.js"], files["mujoco.wasm"]


def _unpacked(package: Path) -> Files:
    try:
        with tarfile.open(fileobj=io.BytesIO(read_bytes(package, LARGEST))) as archive:
            members = {name: archive.extractfile(f"package/{name}") for name in SHA512}
            return {name: member.read() for name, member in members.items() if member}
    except (tarfile.TarError, KeyError) as error:
        raise UserError(f"{package} is not npm's {PACKAGE}: {error}") from error


def _fetch() -> Files:
    try:
        if npm := shutil.which("npm"):
            with tempfile.TemporaryDirectory() as folder:
                subprocess.run(
                    [npm, "pack", PACKAGE, "--silent", "--pack-destination", folder],
                    check=True,
                    capture_output=True,
                    timeout=PATIENCE,
                )
                return _unpacked(next(Path(folder).iterdir()))
        files = {}
        for name in SHA512:
            with urllib.request.urlopen(f"{NETWORK}/{name}", timeout=PATIENCE) as found:
                files[name] = found.read(LARGEST)
        return files
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise UserError(
            f"cannot fetch {PACKAGE}: {getattr(error, 'reason', None) or error}; where there is no network, "
            f"give the file that `npm pack {PACKAGE}` writes elsewhere with --mujoco-package FILE"
        ) from error

"""MuJoCo's official build for browsers: a package of npm, fetched once, or given as a
file."""

import contextlib
import hashlib
import io
import tarfile
import urllib.request
from pathlib import Path

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_bytes, write_bytes
from bp2_rl.base.processes import cache_folder

VERSION = "3.14.0"
SHA512 = (
    "58f51889dbb8171f3eb8ce2142ff3448e03489fa561abb0d260b8ab3c24157c4"
    "824f18ca436febaac87cf349d41f4fd5c1af2fb9e7e086f090924a1e7776e452"
)
"""Of the package's file, as npm has published it."""
URL = f"https://registry.npmjs.org/@mujoco/mujoco/-/mujoco-{VERSION}.tgz"
LARGEST = 32 << 20  # bytes
PATIENCE = 60.0  # s, for which a silent network is waited for


def mujoco_files(given: Path | None) -> tuple[bytes, bytes]:
    """Return mujoco.js and mujoco.wasm from the package's file: `given`, or from the
    cache, or else from the network.

    Raises:
        UserError: the file cannot be had, or is another than the pinned one.
    """
    kept = cache_folder() / f"mujoco-wasm-{VERSION}.tgz"
    place = given or (kept if kept.is_file() else None)
    content = read_bytes(place, LARGEST) if place else _fetch()
    _require_pinned(content, str(place or URL))
    if place is None:
        with contextlib.suppress(OSError):  # then it is fetched again the next time
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(kept, content)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        members = [
            archive.extractfile(f"package/mujoco.{end}") for end in ("js", "wasm")
        ]
        script, code = (member.read() for member in members if member)
    return script, code


def _fetch() -> bytes:
    try:
        with urllib.request.urlopen(URL, timeout=PATIENCE) as answer:
            return answer.read(LARGEST)
    except (OSError, ValueError) as error:  # of the network, or of a proxy's address
        raise UserError(
            f"cannot fetch {URL}: {getattr(error, 'reason', None) or error}; where there is no network, "
            "give that file with --mujoco-package FILE"
        ) from error


def _require_pinned(content: bytes, source: str) -> None:
    found = hashlib.sha512(content).hexdigest()
    if found != SHA512:
        raise UserError(
            f"{source} is not npm's @mujoco/mujoco {VERSION}: its SHA-512 begins with {found[:12]}, not with "
            f"{SHA512[:12]}; remove the file, or give another one with --mujoco-package FILE"
        )

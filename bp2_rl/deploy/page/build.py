"""Compile page.wasm: python -m bp2_rl.deploy.page.build.

It needs a clang with the standard libraries for WebAssembly: `pip install
ziglang==0.17.1`, which compiles the file to the same bytes everywhere. The file ships,
so that exporting a page needs no compiler.
"""

import hashlib
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
CPP = HERE.parent / "cpp"
CODE, SUMS = HERE / "page.wasm", HERE / "page.sha256"
SOURCES = HERE / "page.cpp", HERE / "bp2_motors.hpp", CPP / "bp2_controller.hpp"
WARNINGS = "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror"
FLAGS = (
    *("-std=c++17", "-O2", "-fno-exceptions", "-fno-rtti", *WARNINGS),
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-msimd128", "-s"),
)


def compile_page(code: Path) -> None:
    """Compile the page's C++ to a file of WebAssembly.

    Raises:
        subprocess.CalledProcessError: it does not compile.
    """
    zig = sys.executable, "-m", "ziglang", "c++"
    files = f"-I{CPP}", str(SOURCES[0]), "-o", str(code)
    subprocess.run([*zig, *FLAGS, *files], check=True)


def sums() -> str:
    """Return the SHA-256 of page.wasm and of its sources, a line each, as `sha256sum`
    writes them."""
    return "".join(
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n"
        for file in (CODE, *SOURCES)
    )


if __name__ == "__main__":
    compile_page(CODE)
    SUMS.write_text(sums())

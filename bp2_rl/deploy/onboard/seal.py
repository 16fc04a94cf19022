"""Update the hashes of a bundle, and its file for C++, after its owner has edited a
file, such as the limits in `deploy.json`.

python -m onboard.seal                     # in the bundle's folder
"""

import sys
from pathlib import Path

from .binary import repack
from .contents import BundleError, seal
from .controller import OnboardController


def main() -> int:
    """Seal the bundle that this code is part of; return 2 if it cannot be sealed or
    loaded."""
    folder = Path(__file__).resolve().parent.parent
    try:
        changed = seal(folder)
        OnboardController(folder)
        repack(folder)
        changed += seal(folder)
    except BundleError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"sealed {folder}; changed: {', '.join(changed) or 'nothing'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

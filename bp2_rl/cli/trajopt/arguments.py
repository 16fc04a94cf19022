"""What several of the commands are told."""

from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.bounds import Within

OUT = Path("reports/trajopt")
Flat = tyro.conf.arg(name="")
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
Workers = Annotated[int, Within(1, 256)]

"""`bp2 paper COMMAND`: what the paper claims, computed again.

A command imports SciPy, CasADi, MuJoCo and Matplotlib only when its flags are right: a
mistake is answered at once.
"""

import functools

from bp2_rl.cli.app import choose, modules

COMMANDS = {
    "figures": "draw the paper's figures, and an index of all its items",
    "scaling": "compare speeds of many robots with the limits of their legs and motors",
    "trajectories": "study optimal trajectories: limits, schemes, objective, co-design, figures",
    "posterior": "infer the unknown parameters of BP2 from the paper's numbers",
    "eval": "run four more benchmarks: endurance, mechanism, efficiency, stability",
}

main = functools.partial(choose, "bp2 paper", modules("bp2_rl.paper.cli", COMMANDS))

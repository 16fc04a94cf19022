"""`bp2 paper COMMAND`: what the paper claims, computed again.

A command imports SciPy, CasADi, MuJoCo and Matplotlib only when its flags are right: a
mistake is answered at once.
"""

import functools

from bp2_rl.cli.app import choose, modules

COMMANDS = {
    "figures": "draw the paper's figures of robots, athletes and pendulums, and the index of all its items",
    "scaling": "the speeds of many robots beside what their legs and motors allow",
    "trajectories": "study optimal trajectories: limits, gaits, limbs, schemes, co-design, where torques come from",
    "posterior": "simulate robots that BP2 may be, and weigh them by the paper's numbers",
    "eval": "put a policy to the deep benchmarks: endurance, mechanism, efficiency, stability",
}

main = functools.partial(choose, "bp2 paper", modules("bp2_rl.paper.cli", COMMANDS))

"""Hardware and trajectory found together (paper, "Co-optimization of Hardware and
Trajectory"), and what it rests on.

The motors stay; gear ratio, leg length and spring stiffness become unknowns of the
trajectory's program. A program as this one has many local optima, so each is sought
from several starts, and along a scan from both ends.

    search        the optimum, from every start
    scan          the cost over one of the three, the others at BP2's values or free
    sensitivity   the optimum under other settings: which numbers of it are the robot's, which are the settings'
    study         all of that, in tables and a `figure`

Everything is a chain of problems, each started from the last one's solution. What is
solved is kept in a folder under the hash of its chain, so whatever was interrupted goes
on where it stood.
"""

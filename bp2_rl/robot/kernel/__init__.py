"""One millisecond of many BP2s at once, written out for the machine that computes it.

MJX and C MuJoCo simulate any robot. This is the same physics for BP2 alone: its tree is four equal legs under a trunk,
so every quantity of the step is one number a robot or one a leg, and all robots stand side by side in the last axis:
(N,) or (4, N). What is computed is then a plain sequence of products and sums over long rows, which processors with
wide registers go through many robots at a time. `tests/robot/kernel` hold it equal to C MuJoCo.

From the bottom up: `vectors`, `design` (what the compiled model says of the robot), `legs` (where everything is, and
the momentum of each joint), `equations` (inertia matrix and bias), `constraints` (floor, joint stops and the solver)
and `millisecond`. Legs are in the order of `specs.LEGS`.
"""

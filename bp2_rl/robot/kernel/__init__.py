"""A fused physics step: one millisecond of many BP2s at once.

MJX and C MuJoCo simulate any robot. This is the same physics for BP2 alone: its tree is four equal legs under a trunk,
so every quantity of the step is one number a robot or one a leg, and all robots stand side by side in the last axis:
(N,) or (4, N). What is computed is then a plain sequence of products and sums over long rows, which processors with
wide registers go through many robots at a time. `tests/robot/kernel` hold it equal to C MuJoCo.

From the bottom up: `vectors`; `fusion_barriers` (what is compiled apart); `design` (what the compiled model says of the
robot); `legs` (where everything is, and the momentum of each joint); `arrowhead` (matrices that couple legs through the
trunk, and Cholesky's factorisation of them); `equations` (inertia matrix and bias); `constraints` (floor, joint stops
and the solver) and `step`. Legs are in the order of `conventions.LEGS`.
"""

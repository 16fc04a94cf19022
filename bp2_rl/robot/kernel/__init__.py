"""A fused physics step: one millisecond for many quadrupeds with the same design at
once.

MJX and C MuJoCo simulate any robot. This is the same physics for quadrupeds whose four
legs are abad, hip and knee in series, with or without a spring along the shank: every
quantity of the step is one number a robot or one a leg, and all robots stand side by
side in the last axis: (N,) or (4, N). What is computed is then a plain sequence of
products and sums over long rows, which processors with wide registers go through many
robots at a time. Numbers that are zero by design are known when the program is traced
and cost nothing. `tests/robot/kernel` hold the step equal to C MuJoCo.

From the bottom up: `vectors`; `bodies`; `fusion_barriers` (what is compiled apart);
`design` (what the compiled model says of the robot); `legs` (where everything is, and
the momentum of each joint); `arrowhead` (matrices that couple legs through the trunk,
and Cholesky's factorisation of them); `equations` (inertia matrix and bias);
`constraints` (floor, joint limits and the solver) and `step`. Legs are in the order FR,
FL, RR, RL.
"""

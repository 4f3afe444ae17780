"""Independent solvers that the library's results are measured against.

Nothing here imports the library: a rival sees a robot only through
:class:`~benchmarks.rivals.arm.Arm`, so an error of ours cannot hide in theirs.
"""

"""Independent solvers with which the results of the library are compared.

These modules do not import the library: a rival gets a robot only through
:class:`~benchmarks.rivals.arm.Arm`, so that both cannot share an error of the library.
"""

"""Robot descriptions: finding, reading and checking URDF and SRDF files.

Callers use :mod:`tominpmp.robot` instead.
"""

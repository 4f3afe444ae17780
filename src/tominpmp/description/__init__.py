"""Robot descriptions: finding, reading, checking and writing their files.

URDF, SRDF, xacro and MJCF files are read, and models of Pinocchio and yourdfpy.

Callers use :mod:`tominpmp.robot` instead.
"""

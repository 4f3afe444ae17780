"""Robot descriptions: finding, reading and checking URDF and SRDF files.

Everything a caller needs of it is in :mod:`tominpmp.robot`.
"""

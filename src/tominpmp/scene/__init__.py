"""Obstacles, at rest or moving: plain data, no geometry library.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w.
"""

"""Where the names of the package are; read by type checkers and at import."""

from .robot import (
    DEFAULT_GRAVITY as DEFAULT_GRAVITY,
    Robot as Robot,
    RobotSource as RobotSource,
    load_robot as load_robot,
    read_source as read_source,
)

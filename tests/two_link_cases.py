"""Planning problems of two links whose minimum time is known, and all cases together.

The extremals are those that a direct method finds from many random starts.
"""

from __future__ import annotations

import numpy as np
from bang_bang import Structure
from optimum_cases import (
    HANGING,
    REST,
    ROD,
    Case,
    friction_cases,
    pendulum_cases,
    rail_cases,
    swing_cases,
    switches,
    weight_cases,
)
from reference_optima import Task, TwoLink
from sample_arms import DOWNWARD, GRAVITY, WEIGHTLESS, Link, make_arm

RODS = (ROD, ROD)
LOADED = (ROD, ROD.with_payload(1.0))


def two_link_case(
    name: str,
    links: tuple[Link, Link],
    effort: tuple[float, float],
    start: tuple[float, float, float, float],
    goal: tuple[float, float, float, float],
    *structures: Structure,
    friction: tuple[float, float] = (0.0, 0.0),
    vertical: bool = False,
) -> Case:
    """A case of two links with turning joints."""
    first, second = links
    gravity = GRAVITY if vertical else 0.0
    mechanism = TwoLink(
        first.inertia + first.mass * first.centre**2 + second.mass * first.length**2,
        second.inertia + second.mass * second.centre**2,
        second.mass * first.length * second.centre,
        friction,
        (
            gravity * (first.mass * first.centre + second.mass * first.length),
            gravity * second.mass * second.centre,
        ),
    )
    return Case(
        name,
        lambda: make_arm(
            *links,
            effort=np.array(effort),
            gravity=DOWNWARD if vertical else WEIGHTLESS,
            damping=np.array(friction),
        ),
        Task(mechanism, [(-limit, limit) for limit in effort], start, goal),
        structures=structures,
    )


def level_cases() -> list[Case]:
    """Two-link arms without gravity."""
    bent, reached = (-0.4, 0.6), (0.9, -0.3)
    # Only the inertias of this arm are published; these links have them.
    scara = (Link(30.0, 0.4, 0.2, 1.36), Link(15.0, 0.4, 0.225, 0.055625))
    return [
        # R. Luus, Iterative Dynamic Programming, 2000, example 12.4.2: two rods of 1 kg
        # and 1 m with 1 kg at the end.
        two_link_case(
            "Luus",
            LOADED,
            (1.0, 1.0),
            (0.0, 0.5, *REST),
            (0.522, 0.5, *REST),
            switches("++", "212", 0.9431404, 1.49114, 2.6275451, 2.9822799),
            switches("+-", "212", 0.3732945, 1.6041727, 2.2718947, 3.2083454),
        ),
        # L. G. Van Willigenburg, Int. J. Control 54 (1991), pages 1097 to 1117.
        two_link_case(
            "Van Willigenburg",
            scara,
            (25.0, 9.0),
            (0.0, 0.0, *REST),
            (1.5, 0.0, *REST),
            switches("-+", "1212", 0.063472, 0.470822, 0.674880, 1.042450, 1.222817),
        ),
        two_link_case(
            "rods",
            RODS,
            (10.0, 5.0),
            (*bent, *REST),
            (*reached, *REST),
            switches("-+", "1212", 0.017155, 0.331608, 0.459850, 0.780638, 0.885389),
            switches("+-", "2121", 0.121634, 0.431526, 0.589658, 0.88566, 0.908267),
        ),
        two_link_case(
            "rods, bent elbow",
            RODS,
            (10.0, 5.0),
            (0.0, 1.2, *REST),
            (1.5, 1.2, *REST),
            switches("-+", "1212", 0.022569, 0.399416, 0.472588, 0.712619, 0.900038),
        ),
        two_link_case(
            "rods, friction",
            RODS,
            (10.0, 5.0),
            (*bent, *REST),
            (*reached, *REST),
            switches("++", "212", 0.3850249, 0.6136611, 0.9543562, 0.9673222),
            friction=(2.0, 1.0),
        ),
        two_link_case(
            "rods, moving ends",
            RODS,
            (10.0, 5.0),
            (*bent, 1.0, -0.5),
            (*reached, 0.5, 0.8),
            switches("+-", "212", 0.0925691, 0.3223193, 0.4058292, 0.6605584),
            switches("++", "212", 0.2848514, 0.3225713, 0.5749538, 0.6610626),
        ),
    ]


def vertical_cases() -> list[Case]:
    """Two-link arms that lift their own weight, and a payload."""
    low, high = (HANGING + 0.2, 0.3), (0.3, 0.8)
    light, strong, damped = (40.0, 15.0), (60.0, 25.0), (2.0, 1.0)
    return [
        two_link_case(
            "vertical rods",
            RODS,
            light,
            (*low, *REST),
            (*high, *REST),
            switches("-+", "1212", 0.041397, 0.240716, 0.362144, 0.421282, 0.533007),
            vertical=True,
        ),
        two_link_case(
            "vertical rods, friction",
            RODS,
            light,
            (*low, *REST),
            (*high, *REST),
            switches("+-", "2121", 0.211183, 0.389416, 0.496794, 0.563734, 0.599742),
            switches("-+", "1212", 0.082629, 0.364933, 0.489988, 0.564742, 0.620433),
            switches("++", "122", 0.4928031, 0.5079873, 0.6761375, 0.6789717),
            friction=damped,
            vertical=True,
        ),
        two_link_case(
            "vertical rods, payload",
            LOADED,
            strong,
            (*low, *REST),
            (*high, *REST),
            switches("-+", "1212", 0.073766, 0.306417, 0.461687, 0.466556, 0.635979),
            switches("+-", "2121", 0.090207, 0.313749, 0.456433, 0.532027, 0.637527),
            vertical=True,
        ),
        two_link_case(
            "vertical rods, payload, friction",
            LOADED,
            strong,
            (*low, *REST),
            (*high, *REST),
            switches("+-", "2121", 0.160644, 0.390822, 0.547176, 0.593984, 0.670492),
            switches("-+", "1212", 0.112868, 0.393000, 0.554661, 0.570823, 0.694457),
            friction=damped,
            vertical=True,
        ),
        two_link_case(
            "vertical rods, payload, moving ends",
            LOADED,
            strong,
            (-1.2, 0.3, 0.8, -0.6),
            (*high, -0.4, 0.5),
            switches("+-", "2121", 0.145844, 0.361253, 0.530015, 0.582950, 0.650192),
            switches("-+", "1212", 0.102932, 0.338435, 0.509993, 0.561372, 0.659526),
            friction=damped,
            vertical=True,
        ),
    ]


FAMILIES = {
    "rail": rail_cases,
    "weight": weight_cases,
    "friction": friction_cases,
    "pendulum": pendulum_cases,
    "swing": swing_cases,
    "level": level_cases,
    "vertical": vertical_cases,
}
CASES = {
    family: {case.name: case for case in make()} for family, make in FAMILIES.items()
}


def all_cases() -> dict[str, Case]:
    """All cases by name."""
    return {name: case for cases in CASES.values() for name, case in cases.items()}

"""The result of an identification as tables and text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from amulett_gym.identification.ensemble import DETERMINED
from amulett_gym.reporting.table import Table
from amulett_gym.studies.paper.study import CHOICES, STIFFENING
from amulett_gym.studies.paper.tables import PROTOCOL


def spread_table(content: Mapping[str, Any]) -> Table:
    """Return the identified parameters, and which of them the tables determine."""
    weight = PROTOCOL.damping_mass * PROTOCOL.damping_arm**2
    return Table(
        "What the tables determine",
        (
            "parameter",
            "value",
            "unit",
            "equally good range",
            "searched range",
            "determined",
            "source of the search range",
        ),
        [
            [
                *(f"`{item['name']}`", f"{item['value']:.4g}", item["unit"], f"{item['low']:g} to {item['high']:g}"),
                *("{:g} to {:g}".format(*item["bounds"]), "yes" if item["determined"] else "no", item["source"]),
            ]
            for item in content["spread"]
        ],
        "`radius_ratio`: radius of the drives' pulleys over that of the joint's pulley. `max_force`: string force at "
        "which the springs saturate, at the string deflection `max_deflection`. Half-width: distance of a spring's "
        "anchor from the string's axis. `width_ratio`: half-width over `max_deflection`. `length_ratio`: free length "
        "of a spring over the half-width. "
        f"Equally good: parameter sets whose cost is within {content['ensemble']['equal_cost']:g} of the lowest one. "
        f"A parameter is determined if the equally good sets cover at most {100.0 * DETERMINED:g} % of its searched "
        "range and do not reach its ends. Shares are measured on a logarithmic scale, except for `length_ratio`. The "
        "control period has five possible values; it is determined if the equally good sets use one value or two "
        "neighbouring ones. For comparison with the inertia: the weight of the damping experiment "
        f"alone, {1000.0 * PROTOCOL.damping_mass:g} g at {1000.0 * PROTOCOL.damping_arm:g} mm, has a moment "
        f"of inertia of {weight:.2g} kg m2.",
        left=(0, 2, 6),
    )


def in_words(content: Mapping[str, Any]) -> str:
    """Return a study for the terminal: the parameters and their spread, the spring laws, and the starts."""
    head = (
        f"Least cost: {content['ensemble']['least_cost']:.3f}. Sets within {content['ensemble']['equal_cost']:g} of "
        f"it count as equally good; a walk found {content['ensemble']['members']} of them.\n"
        f"Chosen among about {CHOICES} of them, whose strings are at least {STIFFENING:g} times stiffer at 10 N than "
        "at 4 N if any are: the one that explains most rows, by noise that is not reported. In the report it explains "
        f"{content['explained']} of {content['of']}, at a cost of {content['cost']:.3f}.\n"
    )
    starts = ", ".join(f"{start['cost']:.3f} (seed {start['seed']})" for start in content["starts"])
    parameters = spread_table(content)
    parameters = replace(parameters, head=parameters.head[:-1], rows=[row[:-1] for row in parameters.rows])
    springs = Table(
        "Spring laws, all other parameters searched again:",
        ("", "free length / half width", "cost", "rows", "stiffness at 10 N / at 4 N"),
        [
            [s["law"], f"{s['length_ratio']:g}", f"{s['cost']:.3f}", str(s["met"]), f"{s['stiffening']:.2f}"]
            for s in content["springs"]
        ],
    )
    readings = Table(
        "Readings, each alone, all parameters searched again:",
        ("", "cost", "rows"),
        [
            [f"{item['reading']} {item['choice']}", f"{item['cost']:.3f}", str(item["explained"])]
            for item in content["readings_refitted"]
        ],
        note=f"Cost of the starts: {starts}",
    )
    return "\n\n".join([head.rstrip(), *(table.text() for table in (parameters, springs, readings))])

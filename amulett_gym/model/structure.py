"""Elastic structure between drives and joint: the printed parts, in series with the springs of each string.

The deflection that drive and joint give a string is that of its springs, y, and that of the structure::

    Delta l = y + f(y) / K_s

so the string as a whole is softer than its springs, with the slope f' K_s / (f' + K_s). This is static, and part of the
tables of the string (`string_tables`): a tick does the same with other numbers. The potentiometer is on a spring and
shows y alone. The microcontroller has the tables of the springs: it estimates forces rightly, while what it computes
from angles (co-contraction fed forward, observed forces) does not know how far the structure gives way.

A scenario's factor of the springs (`layout.DEVICE_FACTORS`) scales the force of the string, its structure included.

K_s, assumed
    The paper gives no number, but an effect: it takes 5 % as the margin of the string force because of the elasticity
    of its printed parts (section 2.2). A force that is inferred from a length is wrong by f'/K_s: 5 % at 5 N, where the
    identified springs have f' = 3.9 kN/m, is K_s = 78 kN/m. A printed bracket as a cantilever, 40 mm long, 20 mm wide
    and 8 mm thick, of PLA with a bending modulus of E = 2.2 GPa (data sheet of Polymaker PolyTerra PLA, V5.3, ISO 178),
    has 3 E I / L^3 = 88 kN/m. Several such parts in series have 20 to 90 kN/m. The default is 80 kN/m.

The springs' mass is left out
    The identified linear springs have k = 9.7 kN/m each. Steel wire of 1.2 mm in 4 coils of 8 mm has G d^4/(8 D^3 n) =
    10 kN/m and weighs 1.3 g with its hooks. A third of that moves with the string: four springs add 1.7 g at no more
    than the joint pulley's radius of 40 mm, 3e-6 kg m2, which is 0.06 % of the arm's inertia (identified to -5 and
    +30 %). A spring's own first resonance, sqrt(k/m)/2, is at 1.4 kHz; the control period is 2.5 ms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from amulett_gym.model import cubics
from amulett_gym.model.spring import CELLS, Continuation, SpringTables, build_tables
from amulett_gym.profile import Profile

Values = NDArray[np.float64]

_FARTHEST = 4.0
"""Deflection of springs by the geometric law up to which a string's tables go, in units of the springs' range."""


def string_tables(profile: Profile) -> SpringTables:
    """Return the tables of a device's strings: those of the springs, in series with the structure if there is one."""
    tables = build_tables(profile.spring)
    return tables if profile.structure is None else in_series(tables, profile.structure.stiffness)


def in_series(tables: SpringTables, stiffness: float) -> SpringTables:
    """Return the tables of springs in series with a structure.

    Parameters
    ----------
    tables : SpringTables
        Of the springs alone.
    stiffness : float
        K_s [N/m], more than 0.

    Returns
    -------
    SpringTables
        Force and the linear spring's deflection over the deflection of the string. What the microcontroller has,
        `estimated_force`, `estimated_slope` and `max_spring_deflection`, stays that of the springs. What follows the
        tables' end is in series as well. Where the springs go on by the geometric law, the tables end at 4 times the
        springs' range, and straight lines follow.
    """
    springs = _Springs(tables)
    end = _FARTHEST if tables.beyond.width > 0.0 else 1.0
    most = end * tables.max_deflection + float(springs.force(np.array(end))) / stiffness
    own = springs.deflection(np.linspace(0.0, most, CELLS + 1), stiffness, end)
    own[0], own[-1] = 0.0, end  # exactly: a slack string has no force

    def rate(slope: Values) -> Values:
        """Return the springs' deflection over the string's, both in units of their own range."""
        return most / (tables.max_deflection + slope / stiffness)

    slope, last = springs.slope(own), springs.slope_beyond(np.array(end))
    beyond = last * rate(last), springs.slider_slope_beyond(np.array(end)) * rate(last)
    series = replace(
        tables,
        force=_hermite(springs.force(own), slope * rate(slope)),
        spring_deflection=_hermite(springs.slider(own), springs.slider_slope(own) * rate(slope)),
        max_deflection=most,
        beyond=Continuation(slope=float(beyond[0]), slider=float(beyond[1])),
    )
    for table in (series.force, series.spring_deflection):
        table.flags.writeable = False
    return series


class _Springs:
    """The springs alone, as functions of their deflection in units of their range."""

    def __init__(self, tables: SpringTables) -> None:
        self.law, self.range = tables.beyond, tables.max_deflection
        self._knots = np.linspace(0.0, 1.0, CELLS + 1)
        scales = float(CELLS) ** np.arange(4)
        self._force, self._slider = tables.force * scales, tables.spring_deflection * scales

    def deflection(self, string: Values, stiffness: float, end: float) -> Values:
        """Return the deflection up to `end` at that of a string [m] with a structure [N/m], by bisection."""
        low, high = np.zeros_like(string), np.full_like(string, end)
        for _ in range(60):
            middle = 0.5 * (low + high)
            short = middle * self.range + self.force(middle) / stiffness < string
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return 0.5 * (low + high)

    def force(self, x: Values) -> Values:
        """Return the force [N]."""
        law, further = self.law, np.maximum(x, 1.0)
        rise = further * (1.0 - law.free_length / np.hypot(law.width, further))
        rise -= 1.0 - law.free_length / np.hypot(law.width, 1.0)
        return cubics.value(self._knots, self._force, np.minimum(x, 1.0)) + law.slope * rise

    def slope(self, x: Values) -> Values:
        """Return the slope of the force [N]; at the end of the tables, theirs."""
        slope = cubics.slope(self._knots, self._force, np.minimum(x, 1.0))
        return np.where(x > 1.0, self.slope_beyond(x), slope)

    def slope_beyond(self, x: Values) -> Values:
        """Return the slope of the force from the tables' end on [N]."""
        law, further = self.law, np.maximum(x, 1.0)
        return np.asarray(law.slope * (1.0 - law.free_length * law.width**2 / np.hypot(law.width, further) ** 3))

    def slider(self, x: Values) -> Values:
        """Return the linear spring's deflection [m]."""
        rise = np.hypot(self.law.width, np.maximum(x, 1.0)) - np.hypot(self.law.width, 1.0)
        return cubics.value(self._knots, self._slider, np.minimum(x, 1.0)) + self.law.slider * rise

    def slider_slope(self, x: Values) -> Values:
        """Return the slope of the linear spring's deflection [m]; at the end of the tables, theirs."""
        slope = cubics.slope(self._knots, self._slider, np.minimum(x, 1.0))
        return np.where(x > 1.0, self.slider_slope_beyond(x), slope)

    def slider_slope_beyond(self, x: Values) -> Values:
        """Return the slope of the linear spring's deflection from the tables' end on [m]."""
        further = np.maximum(x, 1.0)
        return np.asarray(self.law.slider * further / np.hypot(self.law.width, further))


def _hermite(values: Values, slopes: Values) -> Values:
    """Return cubic coefficients (constant term first) by values and their slopes over the whole range."""
    return cubics.through(np.arange(CELLS + 1.0), values, slopes / CELLS)

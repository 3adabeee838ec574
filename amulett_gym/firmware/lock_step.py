"""One device whose control loop is outside the simulation: its metrics, and an agent step around its control ticks.

The kernel leaves a device's commands as they are in a tick that its loop misses. So a loop outside sets the commands,
and the kernel's own misses every tick: drives, arm, sensors and setpoint move on as ever, without a second compilation.
"""

from __future__ import annotations

import numpy as np

from amulett_gym.envs.transition import FIRST_READING, FIRST_TERM, costs, write_report, write_reward
from amulett_gym.jit.compiled import compiled
from amulett_gym.model.spring import find_position, look_up_curve
from amulett_gym.simulation.commands import command_drives
from amulett_gym.simulation.kernel import next_late, setpoint_kick, shares
from amulett_gym.simulation.layout import LANES
from amulett_gym.simulation.metrics import start_counting

ALWAYS = 2.0
"""A `late_probability` with which the kernel's loop misses every tick."""


@compiled
def misses_tick(c_blocks, s_blocks, device):
    """Return whether the kernel's loop misses a device's next control tick."""
    block, lane = device // LANES, np.uint64(device % LANES)
    return next_late(c_blocks[block], s_blocks[block], lane, lane + np.uint64(1)) == lane


@compiled
def command_device(p, c_blocks, s_blocks, motion, paper, commands, tension, agonist):
    """Let the first device command its drives as a loop outside wants, with the metrics that the kernel's loop has.

    `motion` is an array of one `layout.MOTION_BLOCK` to work in. `paper`: whether that is the paper's loop, in which a
    jump of the setpoint kicks the commands. `commands` [rad] has shape (2,), `tension` is its setpoint [N], `agonist` 1
    or -1.
    """
    m, c, s, i = motion[0], c_blocks[0], s_blocks[0], np.uint64(0)
    start_counting(p[0], c, s, m, i, i + np.uint64(1))
    s.switch_count[i] += m.counting[i] if agonist != s.agonist[i] else 0.0
    s.agonist[i], s.tension_setpoint[i] = agonist, tension
    kick = setpoint_kick(p[0], s, m, i) if paper else 0.0
    s.setpoint_jump[i] = 0.0
    biceps_share, triceps_share = shares(p[0], agonist)
    command_drives(p[0], s, m, i, commands[0], commands[1], biceps_share * kick, triceps_share * kick)


@compiled
def set_stiffness(p, g, s_blocks):
    """Set the stiffness [N m/rad] that a loop of `layout.BY_STIFFNESS` asks for at the first device's tension."""
    s, i = s_blocks[0], np.uint64(0)
    start = find_position(g[0].force_table, g[0].position_table, s.tension_setpoint[i])
    _, slope, _ = look_up_curve(g[0].force_table, start)
    s.stiffness_setpoint[i] = 2.0 * slope * (g[0].inverse_max_deflection * p[0].joint_radius * p[0].joint_radius)


@compiled
def open_step(e, s_blocks, report):
    """Fill the reward's terms in the first device's report with the costs before an agent step."""
    terms = report[0, FIRST_TERM:FIRST_READING]
    terms[0], terms[1], terms[2], terms[3] = costs(e[0], s_blocks[0], np.uint64(0))


@compiled
def close_step(p, e, c_blocks, s_blocks, report):
    """Report the first device's reward and state after an agent step."""
    write_reward(e[0], c_blocks[0], s_blocks[0], np.uint64(0), report[0])
    write_report(p[0], c_blocks[0], s_blocks[0], np.uint64(0), report[0])

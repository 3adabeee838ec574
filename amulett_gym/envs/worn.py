"""The environments in which the device is worn."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from amulett_gym import WORN_ID
from amulett_gym.envs.settings import Settings, VectorSettings, signature
from amulett_gym.envs.single import TensionEnv
from amulett_gym.envs.vector import TensionVectorEnv
from amulett_gym.envs.worn_episodes import WornEpisodes
from amulett_gym.envs.worn_settings import WornSettings, WornVectorSettings


class WornEnv(TensionEnv):
    """`Amulett/Worn-v0`: choose how stiff a worn exoskeleton is, and how much it follows its wearer.

    ## Description

    The AMULETT elbow on a person's forearm, by a cuff. The scenario's moves are what the *wearer* intends; the device
    does not know them. It measures the torque of the wearer on its cuff, and its position setpoint follows that torque
    (admittance). Pushes act on the wearer's hand, and a payload is put into it. The agent chooses the co-contraction of
    the strings, which a control loop feeds forward, and the assistance: with 1 the device follows the wearer, with 0 it
    keeps its place. All that is not said here is as in :class:`amulett_gym.envs.single.ScalingEnv`.

    The setpoint's rate is [(1 - a) G_0 + a G] db(tau + T tau') + a c v, with the assistance a, the measured torque tau
    of the wearer on the device, a dead band db, and the measured joint velocity v; gains and dead band are the
    profile's, `wearer.admittance`. A wearer has a forearm with hand, two muscles, a delayed reflex, and an anticipation
    of the own arm's dynamics (:mod:`amulett_gym.model.wearer`, :mod:`amulett_gym.tasks.wearer`).

    ## Action Space

    `Box(-1, 1, (2,), float32)`, reached on a ramp that takes the `agent_period`:

    | Num | Action                                      | Min      | Max       | Unit |
    |-----|---------------------------------------------|----------|-----------|------|
    | 0   | co-contraction, as tension of both strings  | -1 (0 N) | 1 (15 N)  | N    |
    | 1   | assistance                                  | -1 (0)   | 1 (1)     | 1    |

    `tension_range=(low, high)` sets another range of tensions [N]. An episode begins without assistance.

    ## Observation Space

    `Box(-1, 1, (16,), float32)`: the microcontroller's values, divided by a fixed scale and clipped to [-1, 1].

    | Num | Observation                                      | Min     | Max    | Scale: 1 stands for |
    |-----|--------------------------------------------------|---------|--------|---------------------|
    | 0   | position error, setpoint minus measured angle    | -1      | 1      | 90 deg              |
    | 1   | measured joint angle (flexion is positive)       | -1      | 1      | 150 deg             |
    | 2   | joint velocity, filtered from the measured angle | -1      | 1      | 500 deg/s           |
    | 3   | position setpoint of the device                  | -1      | 1      | 150 deg             |
    | 4   | 1; if the wearer is guided, time since the       | 0       | 1      | 2 s                 |
    |     | setpoint began to move                           |         |        |                     |
    | 5   | estimated string tension, biceps                 | 0       | 1      | 20 N                |
    | 6   | estimated string tension, triceps                | 0       | 1      | 20 N                |
    | 7   | measured spring deflection, biceps               | 0       | 1      | end of the table    |
    | 8   | measured spring deflection, triceps              | 0       | 1      | end of the table    |
    | 9   | agonist: 1 biceps, -1 triceps                    | -1      | 1      | 1                   |
    | 10  | drive command, biceps                            | -1      | 1      | 720 deg             |
    | 11  | drive command, triceps                           | -1      | 1      | 720 deg             |
    | 12  | co-contraction in force (the last action)        | -1      | 1      | the action's scale  |
    | 13  | measured torque of the wearer on the cuff        | -1      | 1      | 2 N m               |
    | 14  | its rate, filtered                               | -1      | 1      | 20 N m/s            |
    | 15  | assistance in force (the last action)            | 0       | 1      | 1                   |

    ## Rewards

    Minus the weighted costs of the step, each divided by what the same suite costs the same wearers in a whole episode
    of 10 s without the device, so that 1 stands for the bare arm. The wearers of a guided suite are relaxed, so that
    they then do not move. These divisors are frozen (:mod:`amulett_gym.envs.worn_reward`).

    - `muscle` (0.5): integral of the squares of both muscles' activations;
    - `tracking` (0.3): integral of the squared difference of the elbow's angle and the intention;
    - `cuff` (0.2): integral of the squared torque on the cuff while the intention moves, over that of the muscles'
      torque, without the device, while it moves;
    - `drives` (0.001): ISAV (eq. 8) of both drives' commands, over that of drives that follow the intention of the
      suite assembly exactly;
    - `failure`: if the device left its limits, minus `COST_CAP` for each remaining step of `failure_horizon`.

    A step without failure costs at most `COST_CAP` = 1; above it, all terms are scaled down. `info` holds the weighted
    terms, which sum to the reward, as `reward_muscle` and so on, and raw values, cumulative over the episode from the
    task's begin on: those of the device, whose setpoint is its own, and those of the wearer. T is the control period,
    a_f and a_e are the muscles' activations, tau_c is the true torque of the cuff, and e is the intention minus the
    elbow's angle. The intention moves when it is faster than 5 deg/s. `drive_work` counts the friction of cables at the
    drives' side, too.

    | Metric            | Unit    | Formula                                              | Source |
    |-------------------|---------|------------------------------------------------------|--------|
    | `muscle_effort`   | s       | sum of (a_f^2 + a_e^2) T                             | -      |
    | `cuff_ise`        | N2 m2 s | sum of tau_c^2 T                                     | -      |
    | `cuff_peak`       | N m     | largest abs(tau_c)                                   | -      |
    | `tracking_ise`    | deg2 s  | sum of e^2 T                                         | eq. 7  |
    | `moving_cuff_ise` | N2 m2 s | sum of tau_c^2 T while the intention moves           | -      |
    | `moving_time`     | s       | time in which the intention moves                    | -      |
    | `load_deflection` | deg     | largest abs(e) while a push acts on the hand         | -      |

    `reward_fn=f` replaces the reward: `costs` are `muscle` [s], `tracking` [deg2 s], `cuff` [N2 m2 s], `drives`
    [deg2/s] and `failure`.

    Further entries of `info` are the device's true state, and the wearer's: `elbow_angle` [deg], `elbow_velocity`
    [deg/s], `intention` [deg], `cuff_torque` (on the elbow) [N m], `flexor`, `extensor` (activations) [1], `assistance`
    [1]. `push_torque` acts on the hand.

    ## Starting State

    Device and wearer at rest in the scenario's initial posture. A scenario's key `wearer` says who wears the device;
    without it, that is the default :class:`amulett_gym.tasks.wearer.Wearer`, the middle of the population. A scenario
    with an obstacle is refused. A scenario has the divisors of the environment's suite.

    ## Episode End

    As in `ScalingEnv`.

    ## Arguments

    As those of `ScalingEnv`, except:

    | Keyword          | Default               | Meaning                                                               |
    |------------------|-----------------------|-----------------------------------------------------------------------|
    | `profile`        | `"worn"`              | any device; its group `wearer` says how it is worn, by default with   |
    |                  |                       | the values of :class:`amulett_gym.fitting.Fitting`                    |
    | `suite`          | `"assembly"`          | one of :data:`amulett_gym.tasks.worn_suites.WORN_SUITES`              |
    | `control`        | `"equilibrium-point"` | one of the loops that feed the co-contraction forward (`amulett list`)|
    | `tension_range`  | (0, 15)               | co-contractions at action -1 and +1 [N]                               |
    | `tension_law`    | `"agent"`             | with `"eq6"` or `"eq6-printed"`, the first entry of the action has no |
    |                  |                       | effect                                                                |
    | `reward_weights` | None                  | mapping of the terms above to weights                                 |
    | `track`          | `"schedule"`          | no other                                                              |
    | `privileged`     | False                 | no other                                                              |

    ## Version History

    - v0: first version.
    """

    env_id = WORN_ID
    settings: WornSettings
    settings_type = WornSettings
    __signature__ = signature(WornSettings)

    def _make_episodes(self, settings: Settings) -> WornEpisodes:
        assert isinstance(settings, WornSettings)
        return WornEpisodes(1, settings)


class WornVectorEnv(TensionVectorEnv, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many devices of `Amulett/Worn-v0`, specified by :class:`WornEnv`.

    All else is as in :class:`amulett_gym.envs.vector.TensionVectorEnv`.
    """

    env_id = WORN_ID
    settings: WornVectorSettings
    settings_type = WornVectorSettings
    __signature__ = signature(WornVectorSettings)

    def _make_episodes(self, settings: VectorSettings) -> WornEpisodes:
        assert isinstance(settings, WornVectorSettings)
        return WornEpisodes(settings.num_envs, settings, settings.threads)

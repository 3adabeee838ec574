"""The single environments."""

from __future__ import annotations

import copy
from io import BytesIO
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Space
from numpy.typing import NDArray

from amulett_gym import DRIVES_ID, ENV_IDS
from amulett_gym.envs.arguments import as_numbers, checked_options, device_seeds
from amulett_gym.envs.episodes import Episodes
from amulett_gym.envs.info import info_of
from amulett_gym.envs.settings import DrivesSettings, Settings, signature
from amulett_gym.envs.transition import FIRST_TERM
from amulett_gym.errors import AmulettError
from amulett_gym.profile import Profile
from amulett_gym.simulation.layout import RUNNING
from amulett_gym.tasks.scenario import Scenario

RESET_OPTIONS = ("scenario", "device")
_DEVICE = np.zeros(1, dtype=np.int64)
_FLOAT32 = np.dtype(np.float32)
"""numpy finds them sooner than by their classes: they are needed in each step."""


class TensionEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """`Amulett/Tension-v0`: choose the antagonist's string tension, in N.

    All but the action is as in :class:`ScalingEnv`, whose docstring is the specification.

    ## Action Space

    `Box(-1, 1, (1,), float32)`:

    | Num | Action                               | Min       | Max        | Unit |
    |-----|--------------------------------------|-----------|------------|------|
    | 0   | tension setpoint of the antagonist   | -1 (4 N)  | 1 (15 N)   | N    |

    `tension_range=(low, high)` sets another range [N].
    """

    metadata: dict[str, Any] = {"render_modes": list(Settings.render_modes), "render_fps": 50}
    env_id: ClassVar[str] = ENV_IDS[1]
    acts_by_factor: ClassVar[bool] = False
    settings_type: ClassVar[type[Settings]] = Settings
    __signature__ = signature(Settings)

    def __init__(self, **keywords: Any) -> None:
        self.settings = settings = self.settings_type.read(keywords, self.env_id, self.acts_by_factor)
        self.tension_range = settings.tension_range
        self.episodes = self._make_episodes(settings)
        self.observation_space, self.action_space = spaces_of(self.episodes)
        self._action_shape = (self.episodes.action_size,)
        self.render_mode = settings.render_mode
        self.metadata = {**self.metadata, "render_fps": frame_rate(settings)}
        self._renderer: Any = None
        self._report = np.empty((1, self.episodes.report_size))  # of the last step: nobody else gets it

    def _make_episodes(self, settings: Settings) -> Episodes:
        return Episodes(1, settings)

    @property
    def profile(self) -> Profile:
        """The device; with a fleet, that of the present episode."""
        return self.episodes.profile_of(0)

    @property
    def devices(self) -> tuple[Profile, ...]:
        """The fleet, in which ``info["device"]`` is an index, or the one device."""
        return self.settings.devices

    @property
    def scenario(self) -> Scenario:
        """The present episode's scenario; ``reset(options={"scenario": env.unwrapped.scenario})`` replays it."""
        return self.episodes.unpacked(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            At least 0. It fixes scenarios and noise of this and all later episodes. Without any seed so far, they come
            from `np_random`.
        options : dict, optional
            ``"scenario"``: a `Scenario`, a mapping or a JSON or YAML file to play instead of a drawn one.
            ``"device"``: name of a device of the fleet, instead of a drawn one. A scenario may name one, too.

        Raises
        ------
        AmulettError
            If an option or the device is unknown or the scenario is wrong.
        gymnasium.error.Error
            If the seed is no whole number of at least 0.
        """
        super().reset(seed=seed)
        seeds, options = device_seeds(seed, 1), checked_options(options, RESET_OPTIONS)
        self.episodes.seed(_DEVICE, seeds, self.np_random)
        scenarios, names = ([options[key]] if options.get(key) is not None else None for key in RESET_OPTIONS)
        observation = self.episodes.start(_DEVICE, scenarios, self.episodes.drawn(), names)[0]
        if self._renderer is not None:
            self._renderer.clear()
        if self.render_mode == "human":
            self.render()
        return observation, self._info(self.episodes.report().tolist()[0][FIRST_TERM:])

    def step(self, action: NDArray[np.floating[Any]]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold an action of the space's shape for one agent period; values beyond [-1, 1] are clipped.

        Returns
        -------
        observation, reward, terminated, truncated, info
            `terminated`: the device left its limits. `truncated` is False: the time limit is that of a wrapper.

        Raises
        ------
        AmulettError
            If the action has another shape, is NaN or no number.
        gymnasium.error.ResetNeeded
            If there was no reset yet.
        """
        if not self.episodes.started[0]:
            raise gym.error.ResetNeeded("call reset() before step()")
        actions = np.asarray(action)
        if actions.shape != self._action_shape:
            raise AmulettError(f"the action has shape {actions.shape}; it has to be {self._action_shape}")
        observations = np.empty((1, self.episodes.observation_size), dtype=_FLOAT32)
        self.episodes.step_into(as_numbers(actions), observations, self._report)
        values = self._report.tolist()[0]
        reward = values.pop(0)
        info = self._info(values)
        if self.render_mode == "human":
            self.render()
        return observations[0], reward, info["failure"] != RUNNING, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the present state: an array (height, width, 3) for `rgb_array`, a window for `human`."""
        if self.render_mode is None:
            gym.logger.warn("render() without a render_mode draws nothing; pass render_mode='rgb_array' or 'human'")
            return None
        from amulett_gym.envs.rendering.frame import frame_of
        from amulett_gym.envs.rendering.window import Renderer

        if self._renderer is None:
            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"])
        return self._renderer.draw(frame_of(self.episodes, 0))

    def _repr_png_(self) -> bytes | None:
        """Return a picture of the present state, for notebooks; before any reset, of that after ``reset(seed=0)``."""
        if not self.episodes.started[0]:
            other = copy.deepcopy(self)
            other.render_mode = None
            other.reset(seed=0)
            return other._repr_png_()
        from PIL import Image

        from amulett_gym.envs.rendering.frame import frame_of
        from amulett_gym.envs.rendering.window import Renderer

        picture, file = Renderer("rgb_array", self.metadata["render_fps"]).draw(frame_of(self.episodes, 0)), BytesIO()
        Image.fromarray(picture).save(file, "PNG")
        return file.getvalue()

    def close(self) -> None:
        """Close the window if one is open."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def get_state(self) -> dict[str, Any]:
        """Return a snapshot of the episode and the random generator, which can be pickled.

        An environment made with the same keywords continues from it with the same bits, later episodes included, in any
        process. The state of wrappers, as of `gym.make`'s time limit, is not in it.
        """
        return {"episodes": self.episodes.get_state(), "np_random": self.np_random.bit_generator.state}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a snapshot taken by `get_state`; AmulettError if its number of devices differs."""
        self.episodes.set_state(state["episodes"])
        self.np_random.bit_generator.state = state["np_random"]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}

    def _info(self, values: list[float]) -> dict[str, Any]:
        return info_of(self.episodes, values)


class ScalingEnv(TensionEnv):
    """`Amulett/Scaling-v0`: choose the factor by which eq. 6 scales the desired string tension.

    ## Description

    The AMULETT elbow: two motors ("biceps", "triceps") pull on the joint through strings with non-linear springs. A
    PID controller moves the joint to its setpoint with the agonist; another holds the antagonist's string at a tension
    setpoint. More tension makes the joint stiffer and better damped, and leaves less torque to move with; *changing*
    the tension costs motor effort. The agent chooses the tension, moment by moment. The paper's answer is eq. 6: low
    tension while the arm is far from its target, high tension near it.

    ## Action Space

    `Box(-1, 1, (1,), float32)`, reached on a ramp that takes the `agent_period`:

    | Num | Action                          | Min       | Max       | Unit |
    |-----|---------------------------------|-----------|-----------|------|
    | 0   | scaling factor f_sigma of eq. 6 | -1 (0.4)  | 1 (1.5)   | 1    |

    The tension setpoint is f_sigma times the nominal tension sigma (10 N): 4 to 15 N, the same range as
    `Amulett/Tension-v0`, in which the same action means the same tension. `tension_range=(low, high)` sets another
    range [N]. Below the floor of the force estimates, 5 N, a setpoint commands a release of the string at a rate, not a
    force (docs/environments.md). The ramp moves in each control tick. A late tick leaves the setpoint unchanged; the
    next ramp begins at the setpoint that the last action asked for.

    ## Observation Space

    `Box(-1, 1, (13,), float32)`: the microcontroller's values, divided by a fixed scale and clipped to [-1, 1].

    | Num | Observation                                      | Min     | Max    | Scale: 1 stands for |
    |-----|--------------------------------------------------|---------|--------|---------------------|
    | 0   | position error, setpoint minus measured angle    | -1      | 1      | 90 deg              |
    | 1   | measured joint angle (flexion is positive)       | -1      | 1      | 150 deg             |
    | 2   | joint velocity, filtered from the measured angle | -1      | 1      | 500 deg/s           |
    | 3   | position setpoint                                | -1      | 1      | 150 deg             |
    | 4   | time since the setpoint began to move            | 0       | 1      | 2 s                 |
    | 5   | estimated string tension, biceps                 | 0       | 1      | 20 N                |
    | 6   | estimated string tension, triceps                | 0       | 1      | 20 N                |
    | 7   | measured spring deflection, biceps               | 0       | 1      | end of the table    |
    | 8   | measured spring deflection, triceps              | 0       | 1      | end of the table    |
    | 9   | agonist: 1 biceps, -1 triceps                    | -1      | 1      | 1                   |
    | 10  | drive command, biceps                            | -1      | 1      | 720 deg             |
    | 11  | drive command, triceps                           | -1      | 1      | 720 deg             |
    | 12  | tension setpoint in force (the last action)      | -1      | 1      | the action's scale  |

    ## Rewards

    Minus the weighted costs of the step, each divided by the cost of eq. 6 in a whole episode of the same suite on the
    same device, so that the return of eq. 6 is about -1. These divisors are frozen for the shipped profiles; on another
    device eq. 6 is measured when an environment first needs it, which takes tenths of a second, and is then kept (see
    `envs.eq6_costs`). In `mixed`, each scenario has the weights and divisors of its family, so that all families have
    the same weight:

    - `position` (0.5): position ISE (eq. 7), by the true angle;
    - `effort` (0.45): ISAV (eq. 8) of both drives, summed over control ticks, without the contribution of a jump of
      the position setpoint alone, which is the same under every law and would hide their differences;
    - `tension` (0.05): tension ISE of the antagonist, by the true force;
    - `contact` (0): square of the contact torque; in the family with obstacles, `contact`, its weight is 0.3, that of
      `position` 0.35 and that of `effort` 0.3;
    - `failure`: if the device left its limits, minus `COST_CAP` for each remaining step of `failure_horizon`.

    A step without failure costs at most `COST_CAP` = 1; above it, all terms are scaled down. `info` holds the weighted
    terms, which sum to the reward, as `reward_position` and so on, and raw values, cumulative over the episode. Sums
    are over the control ticks from the task's begin on. T is the control period and e the setpoint minus the true
    angle. In a tick, a drive's command changes by du, of which a jump of the setpoint alone causes dk; the drive turns
    by da, after its lag and its limits. "-": not in the paper.

    | Metric                            | Unit    | Formula                                             | Source      |
    |-----------------------------------|---------|-----------------------------------------------------|-------------|
    | `position_ise`                    | deg2 s  | sum of (e^2 before + e^2 after the tick) T/2        | eq. 7       |
    | `tension_ise`                     | N2 s    | sum of (setpoint - antagonist's true force)^2 T     | eq. 7       |
    | `tension_ise_estimated`           | N2 s    | sum of (setpoint - its estimated force)^2 T         | eq. 7       |
    | `isav_biceps`, `isav_triceps`     | deg2/s  | sum of du^2 / T                                     | eq. 8       |
    | `isav_kick`                       | deg2/s  | sum of dk^2 / T                                     | eq. 8       |
    | `effort_biceps`, `effort_triceps` | deg2/s  | sum of (du - dk)^2 / T                              | eq. 8       |
    | `iav_biceps`, `iav_triceps`       | deg     | sum of abs(du)                                      | section 2.2 |
    | `drive_effort`                    | deg2/s  | sum of da^2 / T, of both drives                     | eq. 8       |
    | `drive_work`                      | J       | sum of max(0, M da), of both drives; M is R_1 f_1,  | eqs. 4-5    |
    |                                   |         | -R_1 f_2, mean of the tick's begin and end          |             |
    | `rise_time`                       | s       | from a step to the first entry into +-2 deg around  | section 2.2 |
    |                                   |         | its target; mean over `steps_risen`, 0 if none did  |             |
    | `settling_time`                   | s       | the same to the last entry; mean over               | section 2.2 |
    |                                   |         | `steps_settled`, 0 if none did                      |             |
    | `overshoot`                       | deg     | largest angle beyond a step's target, at least 0    | section 4   |
    | `contact_ise`                     | N2 m2 s | sum of (contact torque)^2 T                         | as eq. 7    |
    | `contact_peak`                    | N m     | largest abs(contact torque)                         | -           |
    | `push_deflection`                 | deg     | largest abs(e) while a push acts                    | -           |
    | `resting_stiffness`               | N m/rad | mean of R_2^2 (f_1' + f_2') while the setpoint      | eqs. 1, 4-5 |
    |                                   |         | stands and abs(e) <= 2 deg; 0 if it never does      |             |
    | `resting_time`                    | s       | time in which it does                               | section 2.2 |
    | `setpoint_steps`                  | 1       | number of the setpoint's steps and moves            | section 2.2 |
    | `steps_risen`, `steps_settled`    | 1       | number of steps with a rise time, settling time     | section 2.2 |
    | `agonist_switches`                | 1       | number of switches of the agonist                   | section 2.2 |

    Compare the efforts of different control loops by `drive_effort`: without dk, a loop that gets a smooth reference
    is charged in full, and one that gets a jump is not.

    `reward_fn=f` replaces the reward. `f(costs, terms)` gets two dicts of arrays with one entry for each device (one in
    the single environment) and returns the rewards, an array of the same shape::

        def rooted(costs, terms):
            return -((costs["position"] / 50.0) ** 0.5) + terms["effort"] + terms["failure"]


        env = gym.make("Amulett/Scaling-v0", reward_fn=rooted)

    `costs` are the raw costs of the step: `position` [deg2 s], `effort` [deg2/s], `tension` [N2 s], `contact` [N2 m2
    s], and `failure`, 1 if the device left its limits. `terms` are the terms above. If the function computes each entry
    from the entries of the same device, the single and the vector environment give the same bits. A function cannot be
    written as JSON: with one, `env.spec.to_json()` raises a TypeError, and a policy bundle names it only in its
    provenance.

    `info` is flat. In every step and reset it has the same keys, each with a finite number of the same type: a float,
    but for the ints `failure` and, with a fleet, `device`. Its further entries are the true state: `time` [s],
    `joint_angle` [deg], `joint_velocity` [deg/s], `tension_setpoint`, `force_biceps`, `force_triceps` [N],
    `joint_stiffness` [N m/rad], `push_torque`, `contact_torque` [N m], and `failure`: 0, or the number of the limit
    that the device left in :data:`amulett_gym.FAILURES`. With `control` `"torque-stiffness"` or
    `"feedforward-feedback"`, the tension asks for the joint stiffness that it gives without a torque,
    `stiffness_setpoint` [N m/rad]; `joint_stiffness` is what comes. In other loops there is no such entry.

    ## Starting State

    At rest at the scenario's initial angle, both strings settled at the initial tension (the nominal 10 N). The suites'
    tasks begin after 0.5 s, and so do rewards and metrics: time to settle at the tension that the agent chooses.
    `reset(seed=...)` fixes the scenarios and the noise of this and all later episodes. `reset(options={"scenario": s})`
    plays a scenario of your own (a mapping, a JSON or YAML file or a :class:`amulett_gym.tasks.scenario.Scenario`). Its
    key `family` names the suite whose weights and divisors its reward uses, as that of a drawn scenario does; without
    it, `contact` if it has an obstacle, so that contact has a cost, else the environment's suite.

    ## Episode End

    - Termination: the joint leaves +-150 deg, its velocity leaves its limit, or the state is not finite;
      `amulett_gym.FAILURES[info["failure"]]` names the limit.
    - Truncation: after `max_episode_steps`, 500 by default, which is 10 s.

    ## Fleets

    With `fleet=[...]`, each episode has one of several devices; they may differ in everything but what the agent does:
    the control loop, the range of tensions and the agent period have to fit all. The episode's key draws the device,
    each with the same probability; `reset(options={"device": name})` or a scenario's `device.name` chooses it. It is
    `env.unwrapped.devices[info["device"]]`; privileged observations describe it in further entries. Scenarios, divisors
    of the reward and scales of observations are the device's own. In the vector environment, a block of eight
    neighbouring devices has one device of the fleet for all episodes, so use at least eight times as many devices as
    the fleet has.

    ## Arguments

    | Keyword             | Default           | Meaning                                                              |
    |---------------------|-------------------|----------------------------------------------------------------------|
    | `profile`           | `"testbed"`       | `"testbed"`, `"simulation"`, a YAML file or a mapping                |
    | `fleet`             | None              | devices instead of `profile`, see above: a list of profiles, or a    |
    |                     |                   | YAML or JSON file with one                                           |
    | `suite`             | `"steps"`         | one of the suites below                                              |
    | `split`             | `"train"`         | `"train"`, `"validation"`, `"held-out"`: disjoint scenarios; or      |
    |                     |                   | `"shifted"`: outside their ranges                                    |
    | `control`           | `"decentralized"` | the paper's control loop; `"position-only"`: without tension loop,   |
    |                     |                   | the action has no effect; or another loop (`amulett list`), with the |
    |                     |                   | tension as co-contraction, in `tension_range` from 0 to 15 N         |
    | `tension_law`       | `"agent"`         | or `"eq6"`, `"eq6-printed"`, inside the loop; actions have no effect |
    | `track`             | `"schedule"`      | cost in the reward; or `"full-control"`, to compare loops: effort of |
    |                     |                   | the drives' own motion, no tension term, weights scaled to sum to 1  |
    | `reward_weights`    | None              | mapping of term to weight, instead of each family's default          |
    | `reward_fn`         | None              | a reward of your own, see above                                      |
    | `tension_range`     | (4, 15)           | tension setpoints at action -1 and +1 [N], up to 1e6; `action_range`,|
    |                     |                   | in factors for Scaling and in N for Tension, is deprecated           |
    | `agent_period`      | 0.02              | time between two actions [s]; a multiple of the control period       |
    | `action_delay`      | 0                 | control ticks from an agent step's begin to that of its action's     |
    |                     |                   | ramp, fewer than the step has: what a microcontroller takes to       |
    |                     |                   | compute the action; until then the last ramp goes on                 |
    | `observation_noise` | 0.0               | standard deviation added to each observation, in its scaled unit     |
    | `failure_horizon`   | 500               | steps for the cost of a failure: set it with `max_episode_steps`     |
    | `render_mode`       | None              | `"rgb_array"` or `"human"`                                           |
    | `privileged`        | False             | append the hidden state (:mod:`amulett_gym.envs.privileged`), without|
    |                     |                   | `observation_noise`: for the causal reference                        |

    Raises :class:`amulett_gym.errors.AmulettError` for a wrong argument.

    | Suite          | Task                                                                                           |
    |----------------|------------------------------------------------------------------------------------------------|
    | `"paper-step"` | the paper's step from 0 to 45 deg                                                              |
    | `"steps"`      | random setpoint steps                                                                          |
    | `"reach"`      | minimum-jerk reaches                                                                           |
    | `"track"`      | sinusoids and chirps                                                                           |
    | `"pick-place"` | a repeated assembly cycle: reach, hold against a slow push, reach back, dwell                  |
    | `"contact"`    | reaches out and back, through a compliant obstacle in 3 of 4 episodes                          |
    | `"hold-push"`  | hold a posture against pulses, slow pushes and shaking                                         |
    | `"payload"`    | reaches with an unknown payload, horizontal or vertical                                        |
    | `"mixed"`      | all but the paper's step equally often, on devices that differ from the profile                |

    Ranges and their reasons are in :mod:`amulett_gym.tasks.suites`.

    ## Version History

    - v0: first version.
    """

    env_id = ENV_IDS[0]
    acts_by_factor = True


class DrivesEnv(TensionEnv):
    """`Amulett/Drives-v0`: command both drives directly ([12] Stevens et al.).

    There is no control loop between the agent and the drives. All but the action is as in :class:`ScalingEnv`, whose
    docstring is the specification.

    ## Action Space

    `Box(-1, 1, (2,), float32)`, reached on a ramp that takes the `agent_period`:

    | Num | Action                                      | Min           | Max         | Unit |
    |-----|---------------------------------------------|---------------|-------------|------|
    | 0   | mean angle theta_s of both drives           | -1 (-259 deg) | 1 (259 deg) | deg  |
    | 1   | co-contraction sigma, as tension of strings | -1 (0 N)      | 1 (15 N)    | N    |

    The commands are u_1 = theta_s + theta_c and u_2 = theta_s - theta_c, with theta_c = f^-1(sigma) / R_1, limited by
    the profile's `command_limit_deg`. Without a load the joint rests at R_1 / R_2 theta_s, both strings at sigma; a
    load increases the agonist's tension and decreases the antagonist's. The ramps of an episode's first action begin
    where the drives are: at the mean of both commands, and at the tension that half their difference means. A late tick
    leaves the commands unchanged; the next ramp begins at what the last action asked for.

    Entry 12 of the observation is sigma, over `tension_range`. The mean angle is that of the two commands, entries 10
    and 11. The reward is that of the other environments: `effort` is the whole ISAV of the commands, since a jump of
    the position setpoint passes to no command by itself.

    ## Arguments

    As those of :class:`ScalingEnv`, except:

    | Keyword            | Default    | Meaning                                                                        |
    |--------------------|------------|--------------------------------------------------------------------------------|
    | `control`          | `"drives"` | no other                                                                       |
    | `tension_range`    | (0, 15)    | co-contractions at action -1 and +1 [N]                                        |
    | `mean_angle_range` | None       | mean drive angle at action +1 [deg], at most the profile's `command_limit_deg`;|
    |                    |            | None: that of a joint angle of 90 deg, 90 R_2 / R_1, rounded, or this limit    |
    | `tension_law`      | `"agent"`  | with `"eq6"` or `"eq6-printed"`, the second entry of the action has no effect  |

    ## Version History

    - v0: first version.
    """

    env_id = DRIVES_ID
    settings: DrivesSettings
    settings_type = DrivesSettings
    __signature__ = signature(DrivesSettings)

    @property
    def mean_angle_range(self) -> float:
        """Mean drive angle at action +1 [deg]."""
        return self.settings.mean_angle_deg


def spaces_of(episodes: Episodes) -> tuple[Space[Any], Space[Any]]:
    """Return the observation space, then the action space of a device."""
    return Box(-1.0, 1.0, (episodes.observation_size,), np.float32), Box(-1.0, 1.0, (episodes.action_size,), np.float32)


def frame_rate(settings: Settings) -> int:
    """Return the animation's frames per second, one for each agent step."""
    return max(round(1 / settings.agent_period), 1)

"""`amulett play`: show contenders in a window or as a video."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

from amulett_gym import FAILURES
from amulett_gym.cli.options import add_device, add_json, add_options, check_least, chosen_device
from amulett_gym.cli.output import print_json
from amulett_gym.errors import AmulettError

HELP = "show laws and trained policies in a window or as a video"
EXAMPLES = """  amulett play eq6
  amulett play eq6 pretrained --video side-by-side.gif
  amulett play constant:8 --suite hold-push --video hold-push.gif
  amulett play runs/first --episodes 3 --json
  amulett play pretrained --fleet my_devices.yaml --device heavy --video heavy.gif
  amulett play position-only --scenario my-scenario.json --steps 200 --video step.mp4
"""


class _Names:
    """The names of all laws, which are collected only when the help is printed."""

    def __str__(self) -> str:
        from amulett_gym.laws.contenders import contender_names

        return ", ".join(contender_names())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    policy = parser.add_argument(
        "policy",
        nargs="+",
        metavar="POLICY",
        help="%(names)s; a zip of Stable-Baselines3 that you trust. Several play the same scenario side by side",
    )
    setattr(policy, "names", _Names())  # noqa: B010
    add_options(parser, "--trust-pickle", "--suite", "--split", "--scenario")
    add_device(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of scenarios and noise (default: 0)")
    parser.add_argument("--episodes", type=int, default=1, metavar="N", help="number of episodes (default: 1)")
    parser.add_argument("--steps", type=int, metavar="N", help="agent steps in an episode (default: 10 s)")
    video = "write a video instead of opening a window, which needs a display: .gif, .webp, .png (animated) or .mp4"
    parser.add_argument("--video", metavar="FILE", help=video)
    parser.add_argument("--fps", type=int, default=25, help="highest frame rate of the video [Hz] (default: 25)")
    add_json(parser, "metrics and what was written")


def run(arguments: argparse.Namespace) -> int:
    """Play the episodes until the last one ends or the window is closed."""
    _check(arguments)
    import gymnasium as gym

    from amulett_gym.cli.own_policies import own_contenders
    from amulett_gym.envs.rendering.video import write_video
    from amulett_gym.envs.rendering.window import Renderer
    from amulett_gym.evaluation.remarks import device_remarks, loop_remarks, print_remarks
    from amulett_gym.evaluation.runner import Protocol, labels, training_remarks
    from amulett_gym.laws.contenders import loops_of
    from amulett_gym.reporting.progress import Progress

    protocol = Protocol(chosen_device(arguments), arguments.suite, arguments.split, seed=arguments.seed)
    names = list(dict.fromkeys(arguments.policy))
    contenders = own_contenders(names, protocol.profile, protocol.env_id, arguments.trust_pickle)
    remarks = device_remarks(protocol.profile, names, loops=loops_of(contenders), suite=protocol.suite)
    remarks += [*training_remarks(contenders, protocol, task=False), *loop_remarks(contenders)]
    print_remarks(remarks)
    task = arguments.suite if arguments.scenario is None else Path(arguments.scenario).stem
    mode = "human" if arguments.video is None else "rgb_array"
    stages: list[_Stage] = []
    written = renderer = None
    try:
        for contender in contenders:
            keywords = protocol.keywords(contender)
            steps = keywords.pop("max_episode_steps") if arguments.steps is None else arguments.steps
            env = gym.make(protocol.env_of(contender), **{**keywords, "max_episode_steps": steps})
            stages.append(_Stage(contender, env, keywords["agent_period"], steps))
        rate = max(stage.env.metadata["render_fps"] for stage in stages)
        label = labels(names)
        renderer = Renderer(mode, rate, *(f"{label[name]}, {task}" for name in names))
        pictures = _play(stages, renderer, arguments)
        if arguments.video is None:
            for _ in pictures:
                if not renderer.is_open:
                    break
        else:
            shortest, longest = min(stage.period for stage in stages), max(s.period * s.most_steps for s in stages)
            with Progress(arguments.episodes * (round(longest / shortest) + 1), "play", "pictures") as bar:
                frames, seconds = write_video(arguments.video, _counted(pictures, bar), rate, arguments.fps)
            written = {"file": arguments.video, "frames": frames, "seconds": seconds}
    finally:
        if renderer is not None:
            renderer.close()
        for stage in stages:
            stage.env.close()
    if arguments.json:
        about = {key: getattr(arguments, key) for key in ("suite", "split", "seed", "scenario")}
        about |= {"profile": protocol.profile.name, "remarks": remarks, "video": written}
        played = [{"policy": name, "episodes": stage.played} for name, stage in zip(names, stages, strict=True)]
        print_json({**about, **(played[0] if len(played) == 1 else {"policies": played})})
    elif written is not None:
        print(f"wrote {arguments.video}: {frames} frames, {seconds:.1f} s")
    return 0


def _counted(pictures: Iterator[Any], bar: Any) -> Iterator[Any]:
    for picture in pictures:
        bar.update()
        yield picture


def _check(arguments: argparse.Namespace) -> None:
    """Refuse wrong options before large packages are loaded."""
    check_least(arguments, episodes=1, steps=1, fps=1, seed=0)
    from amulett_gym.envs.rendering.video import SUFFIXES, check_video
    from amulett_gym.envs.rendering.window import display_answers

    if arguments.video is not None:
        check_video(arguments.video)
    elif not display_answers():
        raise AmulettError(f"there is no display for a window; --video FILE writes a video ({', '.join(SUFFIXES)})")


class _Stage:
    """One contender in an environment of its own."""

    def __init__(self, contender: Any, env: Any, period: float, most_steps: int) -> None:
        self.contender, self.env, self.period, self.most_steps = contender, env, period, most_steps
        self.played: list[dict[str, Any]] = []
        """Results of the finished episodes."""

    def begin(self, seed: int | None, options: Any) -> None:
        """Begin an episode."""
        from amulett_gym.evaluation.runner import load_contender

        self.observation, _ = self.env.reset(seed=seed, options=options)
        self.policy = load_contender(self.contender, self.env)
        self.ended, self.steps, self.total = False, 0, 0.0

    def advance(self, time: float) -> None:
        """Take the steps that end by `time` [s], unless the episode ends before."""
        from amulett_gym.envs.transition import METRICS
        from amulett_gym.evaluation.metrics import or_nan

        while not self.ended and (self.steps + 1) * self.period <= time * (1.0 + 1e-9):
            action = self.policy(self.observation[None])[0]
            self.observation, reward, terminated, truncated, info = self.env.step(action)
            self.steps, self.total = self.steps + 1, self.total + float(reward)
            self.ended = terminated or truncated
            if self.ended:
                found = or_nan({name: info[name] for name in METRICS})
                failure, metrics = FAILURES[info["failure"]], {name: float(value) for name, value in found.items()}
                self.played.append({"steps": self.steps, "return": self.total, "failure": failure, "metrics": metrics})


def _play(stages: list[_Stage], renderer: Any, arguments: argparse.Namespace) -> Iterator[Any]:
    """Play all episodes; draw and yield the picture at each one's start and after each step of the fastest policy."""
    from amulett_gym.envs.rendering.frame import frame_of

    options = None if arguments.scenario is None else {"scenario": arguments.scenario}
    shortest = min(stage.period for stage in stages)
    for number in range(arguments.episodes):
        for stage in stages:
            stage.begin(arguments.seed if number == 0 else None, options)
        renderer.clear()
        for step in count():
            for stage in stages:
                stage.advance(step * shortest)
            yield renderer.draw(*(frame_of(stage.env.unwrapped.episodes, 0) for stage in stages))
            if all(stage.ended for stage in stages):
                break

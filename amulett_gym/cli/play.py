"""`amulett play`: watch a law or a policy at work, in a window or as a video."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from amulett_gym.cli.output import add_json, print_json
from amulett_gym.cli.own_policies import add_trust
from amulett_gym.errors import AmulettError

HELP = "watch a law or a trained policy, in a window or as a video"
EXAMPLES = """  amulett play eq6
  amulett play constant:8 --suite hold-push --video hold-push.gif
  amulett play runs/first --episodes 3 --json
  amulett play position-only --scenario my-scenario.json --steps 200 --video step.mp4
"""


class _Names:
    """The names of all laws, which are looked up only where the help is printed."""

    def __str__(self) -> str:
        from amulett_gym.laws.contenders import contender_names

        return ", ".join(contender_names())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    policy = parser.add_argument(
        "policy",
        metavar="POLICY",
        help="%(names)s; a zip of Stable-Baselines3 that you trust",
    )
    setattr(policy, "names", _Names())  # noqa: B010
    add_trust(parser)
    parser.add_argument("--suite", default="steps", help="suite of scenarios (default: %(default)s)")
    parser.add_argument("--profile", default="testbed", help="device: a name or a YAML file (default: %(default)s)")
    parser.add_argument("--split", default="held-out", help="train, validation, held-out (default) or shifted")
    parser.add_argument("--seed", type=int, default=0, help="draws scenarios and noise (default: %(default)s)")
    parser.add_argument("--scenario", metavar="FILE", help="play this scenario (JSON or YAML) instead of drawn ones")
    parser.add_argument("--episodes", type=int, default=1, metavar="N", help="how many to play (default: %(default)s)")
    parser.add_argument("--steps", type=int, metavar="N", help="agent steps in an episode (default: 10 s of them)")
    parser.add_argument(
        "--video",
        metavar="FILE",
        help="write a video instead of opening a window, which needs a display: .gif, .webp, .png (animated) or .mp4",
    )
    parser.add_argument("--fps", type=int, default=25, help="most frames a second in the video (default: %(default)s)")
    add_json(parser, "metrics and what was written")


def run(arguments: argparse.Namespace) -> int:
    """Play the episodes, until the last one ends or the window is closed."""
    _check(arguments)
    import gymnasium as gym

    from amulett_gym.cli.own_policies import own_contenders
    from amulett_gym.envs.rendering.video import write_video
    from amulett_gym.envs.rendering.window import Renderer
    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.evaluation.runner import Protocol, labels
    from amulett_gym.laws.contenders import Contender, parse_contender
    from amulett_gym.profile import load_profile
    from amulett_gym.reporting.progress import Progress

    protocol = Protocol(load_profile(arguments.profile), arguments.suite, arguments.split, seed=arguments.seed)
    (named,) = own_contenders([arguments.policy], protocol.profile, protocol.env_id, arguments.trust_pickle)
    contender = named if isinstance(named, Contender) else parse_contender(named)
    remarks = device_remarks(protocol.profile, [arguments.policy])
    print_remarks(remarks)
    keywords = protocol.keywords(contender)
    steps = keywords.pop("max_episode_steps") if arguments.steps is None else arguments.steps
    env = gym.make(protocol.env_id, **{**keywords, "max_episode_steps": steps})
    rate = env.metadata["render_fps"]
    task = arguments.suite if arguments.scenario is None else Path(arguments.scenario).stem
    mode = "human" if arguments.video is None else "rgb_array"
    renderer = Renderer(mode, rate, f"{labels([arguments.policy])[arguments.policy]}, {task}")
    played: list[dict[str, Any]] = []
    written = None
    try:
        pictures = _play(env, contender, renderer, arguments, played)
        if arguments.video is None:
            for _ in pictures:
                if not renderer.is_open:
                    break
        else:
            with Progress(arguments.episodes * (steps + 1), "play", "pictures") as bar:
                frames, seconds = write_video(arguments.video, _counted(pictures, bar), rate, arguments.fps)
            written = {"file": arguments.video, "frames": frames, "seconds": seconds}
    finally:
        renderer.close()
        env.close()
    if arguments.json:
        about = {key: getattr(arguments, key) for key in ("policy", "suite", "split", "seed", "scenario")}
        about |= {"profile": protocol.profile.name, "remarks": remarks}
        print_json({**about, "episodes": played, "video": written})
    elif written is not None:
        print(f"wrote {arguments.video}: {frames} frames, {seconds:.1f} s")
    return 0


def _counted(pictures: Iterator[Any], bar: Any) -> Iterator[Any]:
    for picture in pictures:
        bar.update()
        yield picture


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot work, before anything heavy is loaded."""
    for option, smallest in (("episodes", 1), ("steps", 1), ("fps", 1), ("seed", 0)):
        value = getattr(arguments, option)
        if value is not None and value < smallest:
            raise AmulettError(f"--{option} is {value}; it has to be at least {smallest}")
    from amulett_gym.envs.rendering.video import SUFFIXES, check_video
    from amulett_gym.envs.rendering.window import display_answers

    if arguments.video is not None:
        check_video(arguments.video)
    elif not display_answers():
        raise AmulettError(f"there is no display for a window; --video FILE writes a video ({', '.join(SUFFIXES)})")


def _play(
    env: Any, contender: Any, renderer: Any, arguments: argparse.Namespace, played: list[dict[str, Any]]
) -> Iterator[Any]:
    """Play all episodes; draw and yield the picture at each one's start and after each of its steps.

    What came of an episode that was played to its end is appended to `played`.
    """
    from amulett_gym.envs.rendering.frame import frame_of
    from amulett_gym.evaluation.runner import load_contender

    episodes = env.unwrapped.episodes
    options = None if arguments.scenario is None else {"scenario": arguments.scenario}
    for number in range(arguments.episodes):
        observation, _ = env.reset(seed=arguments.seed if number == 0 else None, options=options)
        policy = load_contender(contender, env)
        renderer.clear()
        yield renderer.draw(frame_of(episodes, 0))
        terminated = truncated = False
        total, steps = 0.0, 0
        while not (terminated or truncated):
            observation, reward, terminated, truncated, info = env.step(policy(observation[None])[0])
            total, steps = total + float(reward), steps + 1
            if terminated or truncated:
                failure, metrics = info["failure"], info["metrics"]
                played.append({"steps": steps, "return": total, "failure": failure, "metrics": metrics})
            yield renderer.draw(frame_of(episodes, 0))

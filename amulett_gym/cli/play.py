"""`amulett play`: watch a law or a policy at work, in a window or as a video."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

from amulett_gym.errors import AmulettError

HELP = "watch a law or a trained policy, in a window or as a video"
EXAMPLES = """  amulett play eq6
  amulett play constant:8 --suite hold-push --video hold-push.gif
  amulett play runs/first --episodes 3 --json
  amulett play position-only --scenario my-scenario.json --steps 200 --video step.mp4
"""

_IMAGES = {".gif": "GIF", ".webp": "WEBP", ".png": "PNG"}
_VIDEOS = (*_IMAGES, ".mp4")
_GIF_FPS = 50  # a GIF counts in 10 ms, and players slow down one with less than two of them between frames


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "policy",
        metavar="POLICY",
        help="eq6, eq6-printed, eq6-held, constant:<N>, position-only or the folder of a trained policy",
    )
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
        help="write a video and open no window: .gif, .webp, .png (animated) or .mp4; "
        "without a display <policy>-<suite>.gif is written in any case",
    )
    parser.add_argument("--fps", type=int, default=25, help="most frames a second in the video (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print metrics and what was written as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Play the episodes, until the last one ends or the window is closed."""
    _check(arguments)
    import gymnasium as gym

    from amulett_gym.evaluation.remarks import device_remarks, print_remarks
    from amulett_gym.evaluation.runner import Protocol, labels
    from amulett_gym.laws.contenders import parse_contender
    from amulett_gym.profile import load_profile

    contender = parse_contender(arguments.policy)
    protocol = Protocol(load_profile(arguments.profile), arguments.suite, arguments.split, seed=arguments.seed)
    remarks = device_remarks(protocol.profile, [arguments.policy])
    print_remarks(remarks)
    keywords = protocol.keywords(contender)
    steps = keywords.pop("max_episode_steps") if arguments.steps is None else arguments.steps
    env = gym.make(protocol.env_id, **{**keywords, "max_episode_steps": steps})
    policy = _load(contender.policy_name, env)
    rate = env.metadata["render_fps"]
    task = arguments.suite if arguments.scenario is None else Path(arguments.scenario).stem
    label = labels([arguments.policy])[arguments.policy]
    renderer, path = _open(arguments, rate, label, task)
    played: list[dict[str, Any]] = []
    written = None
    try:
        pictures = _play(env, policy, renderer, arguments, played)
        if path is None:
            for _ in pictures:
                if not renderer.is_open:
                    break
        else:
            most = min(arguments.fps, _GIF_FPS) if path.suffix.lower() == ".gif" else arguments.fps
            stride = max(-(-rate // most), 1)
            count = _write(path, pictures, arguments.episodes * (steps + 1), rate, stride)
            written = {"file": str(path), "frames": count, "seconds": count * stride / rate}
    finally:
        renderer.close()
        env.close()
    if arguments.json:
        about = {key: getattr(arguments, key) for key in ("policy", "suite", "split", "seed", "scenario")}
        about |= {"profile": protocol.profile.name, "remarks": remarks}
        content = {**about, "episodes": played, "video": written}
        print(json.dumps(content, indent=2, allow_nan=False))
    elif written is not None:
        print(f"wrote {path}: {written['frames']} frames, {written['seconds']:.1f} s")
    return 0


def _open(arguments: argparse.Namespace, rate: int, label: str, task: str) -> tuple[Any, Path | None]:
    """Return a renderer and the video's file: None with a window; one in the current folder without a display."""
    from amulett_gym.envs.rendering.window import Renderer, display_answers

    title = f"{label}, {task}"
    if arguments.video is not None:
        return Renderer("rgb_array", rate, title), Path(arguments.video)
    if display_answers():
        return Renderer("human", rate, title), None
    renderer = Renderer("rgb_array", rate, title)
    name = re.sub(r"[^\w.-]+", "-", f"{label}-{task}")
    path = next(path for k in count() if not (path := Path(f"{name}-{k}.gif" if k else f"{name}.gif")).exists())
    print(f"There is no display for a window; writing {path} instead (--video FILE chooses the name).", file=sys.stderr)
    return renderer, path


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot work before anything heavy is loaded."""
    for option, smallest in (("episodes", 1), ("steps", 1), ("fps", 1), ("seed", 0)):
        value = getattr(arguments, option)
        if value is not None and value < smallest:
            raise AmulettError(f"--{option} is {value}; it has to be at least {smallest}")
    if arguments.video is None:
        return
    suffix = Path(arguments.video).suffix.lower()
    if suffix not in _VIDEOS:
        raise AmulettError(
            f"--video is '{arguments.video}'; its name has to end with {', '.join(_VIDEOS[:-1])} or {_VIDEOS[-1]}"
        )
    if suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise AmulettError(
            "writing .mp4 needs imageio-ffmpeg: install it with 'pip install imageio-ffmpeg', "
            f"or let the name end with {', '.join(_IMAGES)}"
        )


def _load(name: str | None, env: Any) -> Any:
    """Return the policy; for a law inside the loop one whose actions nobody reads."""
    if name is None:
        import numpy as np

        return lambda observation: np.zeros(1, dtype=np.float32)
    from amulett_gym.laws.policies import load_policy

    return load_policy(name, env)


def _play(
    env: Any, policy: Any, renderer: Any, arguments: argparse.Namespace, played: list[dict[str, Any]]
) -> Iterator[Any]:
    """Play all episodes; draw and yield the picture at each one's start and after each of its steps.

    What came of an episode that was played to its end is appended to `played`.
    """
    from amulett_gym.envs.rendering.frame import frame_of

    episodes = env.unwrapped.episodes
    options = None if arguments.scenario is None else {"scenario": arguments.scenario}
    for number in range(arguments.episodes):
        observation, _ = env.reset(seed=arguments.seed if number == 0 else None, options=options)
        renderer.clear()
        yield renderer.draw(frame_of(episodes, 0))
        terminated = truncated = False
        total, steps = 0.0, 0
        while not (terminated or truncated):
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            total, steps = total + float(reward), steps + 1
            if terminated or truncated:
                metrics = {key: value if math.isfinite(value) else None for key, value in info["metrics"].items()}
                played.append({"steps": steps, "return": total, "failure": info["failure"], "metrics": metrics})
            yield renderer.draw(frame_of(episodes, 0))


def _write(path: Path, pictures: Iterable[Any], most: int, rate: int, stride: int) -> int:
    """Write every `stride`-th of at most `most` pictures, drawn `rate` times a second; return how many those were."""
    from itertools import islice

    from tqdm import tqdm

    from amulett_gym.storage.writing import atomic_path

    chosen = tqdm(
        islice(pictures, 0, None, stride),
        total=-(-most // stride),
        desc=path.name,
        unit=" frames",
        leave=False,
        disable=not sys.stderr.isatty(),
    )
    write = _write_mp4 if path.suffix.lower() == ".mp4" else _write_images
    with atomic_path(path) as temporary, chosen:
        return write(temporary, chosen, rate / stride)


def _write_images(path: Path, pictures: Iterable[Any], rate: float) -> int:
    from PIL import Image

    kind = _IMAGES[path.suffix.lower()]
    images = []
    for picture in pictures:
        image = Image.fromarray(picture)
        if kind == "GIF":  # flat colours: dithering would only add noise, and bytes
            image = image.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        images.append(image)
    images[0].save(path, kind, save_all=True, append_images=images[1:], duration=round(1000 / rate), loop=0)
    return len(images)


def _write_mp4(path: Path, pictures: Iterable[Any], rate: float) -> int:
    import imageio_ffmpeg

    from amulett_gym.envs.rendering.picture import SIZE

    count = 0
    writer = imageio_ffmpeg.write_frames(str(path), SIZE, fps=rate, quality=8, ffmpeg_log_level="error")
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(picture)
            count += 1
    except BaseException:
        with suppress(OSError):  # what stopped the playing is the error to report, not the encoder's complaint about it
            writer.close()
        raise
    writer.close()
    if path.stat().st_size == 0:
        raise AmulettError(f"the encoder wrote nothing to '{path}'; a name that ends with .gif needs no encoder")
    return count

"""The benchmark's description: its defaults are those that people copy, and what is wrong is named."""

from pathlib import Path

import pytest
import yaml

from amulett_gym.errors import AmulettError
from amulett_gym.studies.benchmark.description import (
    PAPER_STEP,
    Benchmark,
    load_benchmark,
    quick,
    recipe_folder,
    training_recipe,
)

ROOT = Path(__file__).parents[3]


def test_the_shipped_file_writes_out_the_defaults():
    content = yaml.safe_load((ROOT / "configs" / "benchmark.yaml").read_text())
    assert load_benchmark(ROOT / "configs" / "benchmark.yaml") == load_benchmark() == Benchmark()
    assert set(content) == set(Benchmark.model_fields)


def test_the_claims_number_of_seeds_and_scenarios_is_met():
    description = load_benchmark()
    assert len(description.learned[description.best_learned].seeds) >= 10
    assert description.episodes >= 200
    assert len(description.places()) == 2 * len(description.suites) - 1
    assert (PAPER_STEP, "shifted") not in description.places()


def test_every_recipe_that_is_named_can_be_read():
    folder = recipe_folder(None)
    for entry in load_benchmark().learned.values():
        config = training_recipe(entry, 7, folder)
        assert config.seed == 7
        assert config.env.suite == "mixed"
        assert config.env.privileged == entry.reference


def test_the_quick_one_is_a_small_one_of_the_same_make():
    whole = load_benchmark()
    small = quick(whole)
    assert set(small.suites) < set(whole.suites) and small.headline == whole.headline
    assert small.episodes < whole.episodes and not small.ablations
    assert small.contenders == whole.contenders and set(small.constants) < set(whole.constants)
    ((name, entry),) = small.learned.items()
    assert name == whole.best_learned and len(entry.seeds) == 2
    assert entry.set[: len(whole.learned[name].set)] == whole.learned[name].set


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"suits": ["mixed"]}, "unknown key 'suits'; did you mean 'suites'"),
        ({"suites": ["steps"]}, "headline is 'mixed', which is none of the suites"),
        ({"suites": ["mixed", "step"]}, "unknown suite 'step'.*did you mean 'steps'"),
        ({"splits": ["shifted"]}, "'splits' has to hold held-out"),
        ({"splits": ["train"]}, "splits.0.*'held-out' or 'shifted'"),
        ({"episodes": 1}, "'episodes' is 1"),
        ({"constants": [3.0]}, "3.0 N"),
        ({"contenders": ["eq6", "eq6"]}, "'contenders' names something twice"),
        ({"best_learned": "sacc"}, "unknown learned entry 'sacc'"),
        ({"learned": {"a/b": {"seeds": [0]}}, "best_learned": "a/b"}, "'a/b' cannot be a learned entry's name"),
        ({"learned": {"eq6": {"seeds": [0]}}, "best_learned": "eq6"}, "'eq6' cannot be a learned entry's name"),
        ({"learned": {"x": {"seeds": [1, 1]}}, "best_learned": "x"}, "seeds have to differ"),
        ({"learned": {"x": {"seeds": [1], "reference": True}}, "best_learned": "x"}, "a reference and no contender"),
        ({"ablations": ["stiffness"]}, "unknown reward term 'stiffness'"),
        ({"clairvoyant": {"scenarios": {"mixed": 501}}}, "names 501 of mixed"),
        ({"clairvoyant": {"scenarios": {"mixed": 1}}}, "an interval needs at least 2"),
        ({"bootstrap": {"resamples": 1}}, "'bootstrap.resamples' is 1"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, content, message):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(AmulettError, match=message):
        load_benchmark(path)


def test_a_wrong_recipe_is_named_before_anything_is_trained():
    entry = Benchmark(learned={"x": {"seeds": [0], "set": ["ppo.gama=1"]}}, best_learned="x").learned["x"]
    with pytest.raises(AmulettError, match=r"ppo\.gama.*did you mean 'gamma'"):
        training_recipe(entry, 0, ROOT)

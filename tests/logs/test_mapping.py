"""Mapping files: wrong keys and values are named with what is allowed."""

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.logs.mapping import Mapping, load_mapping


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("angel: q", "unknown key 'angel'; did you mean 'angle'"),
        ("angle: {nam: q}", "unknown key 'angle.nam'; did you mean 'name'"),
        ("angle: {unit: N}", "'angle' has the unit 'N'; units of angle are rad, mrad, deg, rev"),
        ("angle: {sign: 2}", "'angle.sign' is 2"),
        ("angle: {scale: 0}", "'angle.scale' is 0"),
        ("angle: {offset: .nan}", "'angle.offset' is nan"),
        ("angle: 0", "'angle.name' is 0: columns are numbered from 1"),
        ("file: {decimal: dot}", "'file.decimal' is 'dot': Input should be 'point' or 'comma'"),
        ("file: {header: false}", "'time.name' is missing: file.header is false, so give a column's number"),
        ("{file: {header: false}, time: t}", "'time.name' is 't', but file.header is false: give a column's number"),
        ("[1]", "has to hold a mapping"),
    ],
)
def test_a_wrong_mapping_is_refused_by_key(content, message, tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text(content)
    with pytest.raises(AmulettError, match=message) as error:
        load_mapping(path)
    assert "mapping.yaml" in str(error.value)


def test_a_mapping_that_is_not_there_is_refused():
    with pytest.raises(AmulettError, match="cannot read mapping 'none.yaml'"):
        load_mapping("none.yaml")


def test_files_and_contents_are_the_same(tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text("angle: {name: q, unit: °}\ntime: 1\n")
    mapping = load_mapping({"angle": {"name": "q", "unit": "°"}, "time": 1})
    assert load_mapping(path) == mapping == load_mapping(mapping)
    assert load_mapping(None) == Mapping()

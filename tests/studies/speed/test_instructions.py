"""How much of the tick works on several lanes at once: counted in the machine code, for named processors."""

import platform

import pytest

from amulett_gym.errors import AmulettError
from amulett_gym.studies.speed import instructions
from amulett_gym.studies.speed.instructions import RECORDED, STAGES, TARGETS, count_for, counted, llvm_version, recorded

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="the counts are of x86-64 processors")


def test_arithmetic_is_counted_by_the_number_of_lanes():
    arithmetic = "\tvmulpd\t%ymm1, %ymm2, %ymm3\n\tvaddsd\t%xmm1, %xmm2, %xmm2\n\tvsubpd\t%xmm1, %xmm2\n"
    assert counted(arithmetic + "\tvmovapd\t%zmm1, %zmm2\n") == {"scalar": 1, "packed": 2, "bits": 256, "functions": []}
    assert counted("\taddsd\t%xmm0, %xmm1\n")["scalar"] == 1


@pytest.mark.parametrize("call", ["\tmovabsq\t$exp, %rbp\n", "\tcallq\texp\n", "\tcallq\texp@PLT\n"])
def test_functions_of_the_c_library_are_named(call):
    assert counted(call + "\tvmulpd\t%ymm1, %ymm2, %ymm3\n\tmovq\texpected, %rax\n")["functions"] == ["exp"]


@pytest.mark.parametrize("target", TARGETS)
def test_stages_are_as_packed_as_they_were(target):
    """A stage that a change keeps from being vectorised shows here, on any machine."""
    before = recorded()
    if before["llvm"] != llvm_version():
        pytest.skip(f"{RECORDED} is of LLVM {before['llvm']}, this is {llvm_version()}")
    now = count_for(target)
    assert set(now) == set(STAGES)
    for stage, numbers in before["counts"][target].items():
        assert now[stage]["packed"] >= 0.9 * numbers["packed"], stage
        assert now[stage]["scalar"] <= 1.1 * numbers["scalar"] + 2, stage
        assert now[stage]["bits"] >= numbers["bits"], stage
        # A sine in a vectorised stage is computed for devices without weight, too: it took a quarter of the tick.
        assert set(now[stage]["functions"]) <= set(numbers["functions"]) <= {"exp"}, stage


def test_an_unknown_processor_is_named(monkeypatch, capsys):
    with pytest.raises(AmulettError, match=r"'pentium-99'.*x86-64-v3 or icelake-server"):
        count_for("pentium-99")
    monkeypatch.setattr("sys.argv", ["instructions", "--target", "pentium-99"])
    with pytest.raises(SystemExit) as ended:
        instructions.main()
    assert ended.value.code == 2
    assert "pentium-99" in capsys.readouterr().err

from __future__ import annotations

import pytest

from lfrig.bench import sweep
from lfrig.bench.cases import shoot_case
from lfrig.contracts.errors import UsageError
from lfrig.processing.options import Settings


def test_every_combination_is_run() -> None:
    made = sweep.variants(["fusion.planes=16,32", "edges.enabled=True,False", "fusion.pool=mean"])
    assert len(made) == 4
    settings = made["fusion.planes=32 edges.enabled=False fusion.pool=mean"]
    assert (settings.fusion.planes, settings.edges.enabled, settings.fusion.pool) == (32, False, "mean")
    assert settings.dpv == Settings().dpv
    assert sweep.variants([]) == {"as shipped": Settings()}


@pytest.mark.parametrize("choice", ["fusion.plane=3", "nothing.planes=3", "planes=3", "=3", ""])
def test_an_unknown_knob_is_refused(choice: str) -> None:
    with pytest.raises(UsageError, match="no setting"):
        sweep.variants([choice])


def test_a_knob_changes_the_numbers_and_the_table_holds_the_means(capsys: pytest.CaptureFixture[str]) -> None:
    case = shoot_case("marbles", (96, 64), angles_deg=(10.0, 40.0))
    rows = sweep.run_scene(case, [1, 2], sweep.variants(["fusion.planes=6,64"]))
    assert [(row["sources"], row["settings"]) for row in rows] == [
        (n, f"fusion.planes={planes}") for n in (2, 1) for planes in (6, 64)
    ]
    assert rows[0]["mse"] > rows[1]["mse"]
    assert capsys.readouterr().err.count("below the oracle") == 4
    lines = sweep.table(rows + rows).splitlines()
    assert len(lines) == 2 + 4
    assert f"{rows[3]['mse']:.5f}" in lines[3]

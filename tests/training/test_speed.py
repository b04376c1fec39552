"""What a run takes is counted as the run itself counts it."""

from __future__ import annotations

from training.speed import whole_runs


def test_larger_photographs_take_more_of_both_until_the_field_is_as_fine_as_it_gets() -> None:
    runs = whole_runs([100, 250, 800, 1600])["quick"]
    for key in ("samples", "disk"):
        assert runs[100][key] <= runs[250][key] < runs[800][key] == runs[1600][key]
    assert runs[100]["disk"] < runs[250]["disk"]

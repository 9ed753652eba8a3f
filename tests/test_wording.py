"""What a complaint says would have been valid."""

from __future__ import annotations

import pytest
from pydantic import BaseModel, Field

from sumo_nets.fields import fields_of, locate
from sumo_nets.wording import one_of


def test_a_short_list_is_told_whole_and_of_a_long_one_the_names_most_like_the_given_one():
    assert one_of(["bay1", "bay2"], "c7") == "give one of bay1, bay2"
    names = [f"c{x}_{y}" for x in range(10) for y in range(10)]
    told = one_of(names, "c7_55")
    assert told.startswith("give one of 100 names such as ")
    assert "c7_5" in told.removeprefix("give one of 100 names such as ").split(", ")
    assert one_of([]) == "there is none to give"


class Inner(BaseModel):
    begin: int = Field(alias="from")


class Outer(BaseModel):
    parts: list[Inner]


@pytest.mark.parametrize(
    ("location", "path", "keys"),
    [(("parts", 2, "frm"), "parts[2].frm", {"from"}), (("part",), "part", {"parts"})],
)
def test_a_field_is_named_as_the_file_writes_it_with_the_keys_that_its_model_has(location, path, keys):
    found, owner = locate(Outer, location)
    assert found == path
    assert owner is not None
    assert set(fields_of(owner)) == keys

"""What a complaint says would have been valid."""

from __future__ import annotations

import pytest
from pydantic import BaseModel, Field

from sumo_nets.fields import fields_of, locate
from sumo_nets.wording import one_of
from sumo_nets.yaml_file import YamlError, parse_mapping


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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 1\nb: {c: 1, c: 2}", "line 2: not YAML: key 'c' is given twice"),
        ('a: "x\\0y"', "line 1: not YAML: a text with a NUL character"),
        ("a: " + "[" * 1500 + "]" * 1500, "not YAML that can be read: groups within groups, too many deep"),
        ("- a", "['a']: give a mapping of keys to values, such as a: 1"),
    ],
)
def test_yaml_that_is_no_mapping_of_plain_values_is_refused_in_one_line(text, said):
    with pytest.raises(YamlError) as caught:
        parse_mapping(text, "a: 1")
    assert str(caught.value) == said

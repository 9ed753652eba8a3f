"""Pages of the docs site that are generated: keys of scenarios and layouts, columns, commands, and the library.

A hook of mkdocs: it adds the pages to those of this folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    for name, text in pages().items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


def pages() -> dict[str, str]:
    """Name of each generated page -> its text."""
    import sumo_nets.freespace.floorplan
    import sumo_nets.layout
    from parking_sim.config import Scenario

    layout, floorplan = sumo_nets.layout, sumo_nets.freespace.floorplan
    return {
        "scenario": "\n".join(_keys("Keys of a scenario", "", Scenario.model_json_schema())),
        "layout": "\n".join(_keys("Keys of a layout", layout.__doc__ or "", layout.Layout.model_json_schema())),
        "floorplan": "\n".join(_keys("Keys of a floor plan", "", floorplan.FloorPlan.model_json_schema())),
        "sweep": "\n".join(_sweep()),
        "columns": "\n".join(_columns()),
        "commands": "\n".join(_commands()),
        "library": "\n".join(_library()),
    }


def _keys(title: str, intro: str, schema: Mapping[str, Any]) -> Iterator[str]:
    """A table of keys for a model and for each model in it."""
    yield f"# {title}\n"
    yield intro.replace("::\n", ":\n")
    for name, model in ({schema["title"]: schema, **schema.get("$defs", {})}).items():
        if "properties" not in model:
            continue
        yield f"\n## {name}\n"
        yield str(model.get("description", "")).partition("\n\nExample:")[0] + "\n"
        yield "| key | type | default | meaning |\n|---|---|---|---|"
        for key, field in model["properties"].items():
            default = "needed" if key in model.get("required", ()) else f"`{json.dumps(field.get('default'))}`"
            default = default if "default" in field or default == "needed" else ""
            yield f"| `{key}` | {_type(field)} | {default} | {_cell(field.get('description', ''))} |"


def _sweep() -> Iterator[str]:
    from parking_sim.sweep_plan import KEYS

    yield "# Keys of a sweep\n\n| key | type | meaning |\n|---|---|---|"
    for key, (kind, meaning) in KEYS.items():
        yield f"| `{key}` | {kind} | {meaning} |"


def _type(field: Mapping[str, Any]) -> str:
    """What a field may hold, in words; another model as a link."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in field:
            return " or ".join(_type(one) for one in field[several])
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    if "const" in field:
        return f"`{field['const']}`"
    if field.get("type") == "array" and "items" in field:
        return f"list of {_type(field['items'])}"
    if field.get("type") == "object" and isinstance(field.get("additionalProperties"), dict):
        return f"mapping to {_type(field['additionalProperties'])}"
    limits = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    bounds = [f"{sign} {field[key]:g}" for key, sign in limits.items() if key in field]
    return " ".join([str(field.get("type", "any")), *bounds])


def _columns() -> Iterator[str]:
    from analysis.metrics import METRICS
    from analysis.record import COLUMNS, EVENTS
    from parking_sim.columns import run_columns

    yield "# Columns and metrics\n"
    for table, entries in {**COLUMNS, "kinds": EVENTS, "metrics": METRICS, "runs": run_columns()}.items():
        yield f"\n## {table}\n\n| name | unit | meaning |\n|---|---|---|"
        for name, (unit, meaning) in entries.items():
            yield f"| `{name}` | {unit} | {_cell(meaning)} |"


def _commands() -> Iterator[str]:
    import typer

    from parking_sim.cli import app

    yield "# Commands\n"
    yield (
        "Exit codes: 0 done; 1 the run ended with work left, or a check found something; 2 bad input, with one line "
        "that says what would be valid, and nothing written; 130 after Ctrl-C."
    )
    yield from _command(typer.main.get_command(app), "parking-sim", None)


def _command(command: Any, name: str, parent: Any) -> Iterator[str]:
    import typer

    context = typer.Context(command, info_name=name.rpartition(" ")[2], parent=parent)
    yield f"\n## {name}\n\n```text\n{command.get_help(context)}\n```"
    for key in command.list_commands(context) if hasattr(command, "commands") else ():
        yield from _command(command.get_command(context, key), f"{name} {key}", context)


def _library() -> Iterator[str]:
    import parking_sim

    yield "# The library\n\nEach name is one of `parking_sim`: `import parking_sim as ps`.\n"
    for name, module in parking_sim._PLACES.items():
        yield f"\n::: {module}.{name}\n    options: {{heading_level: 2, show_root_heading: true}}\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")

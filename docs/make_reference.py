#!/usr/bin/env python3
"""Writes the reference of topics, services, actions and parameters, and the security policy, from the source.

``./handover`` makes the Python environment; then, from anywhere: ``.handover/venv/bin/python docs/make_reference.py``
writes ``docs/reference.md`` and ``config/sros2_policy.xml``; with ``--check`` it writes nothing and ends with status 1
when they are not what the source says.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
for folder in (REPOSITORY, REPOSITORY / "docs"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))

from graph_scan import EVERY, OPERATOR, REPLAY, Endpoint, cell_nodes, endpoints, qualities, summary  # noqa: E402
from interface_files import PACKAGE, PARTS, Interface, Row, interfaces  # noqa: E402
from sros2_policy import PARAMETER_SERVICES, TYPE_SERVICE, policy  # noqa: E402

REFERENCE = REPOSITORY / "docs" / "reference.md"
POLICY = REPOSITORY / "config" / "sros2_policy.xml"
COMMAND = ".handover/venv/bin/python docs/make_reference.py"
SOMETIMES = "\\*"  # an escaped asterisk
EVERY_NODE = ("cell/heartbeat", "/diagnostics")  # of the base class; named once, not in every row
KIND_TITLES = {
    "publishes": "Publishes",
    "receives": "Receives",
    "serves": "Serves",
    "asks": "Asks",
    "executes": "Executes",
    "commands": "Commands",
}
TYPES = {bool: "boolean", int: "integer", float: "double", str: "string"}
INTRODUCTION = f"""# Reference

<!-- Written by docs/make_reference.py from the source: do not edit. -->

Every topic, service, action, parameter and message of the cell, as the source has them. This page is written by
`{COMMAND}`; a test fails when it differs from the source.

Names are relative: a node started in a namespace has them below it. `/clock` and `/diagnostics` are absolute. Units and
frames follow REP-103 and REP-105: metres, radians, seconds, `world` with z up.
"""


def parameters(node: str) -> Sequence[Any]:
    """Return a node's parameters as it declares them."""
    return tuple(importlib.import_module(f"handover_ros.nodes.{node}").PARAMETERS)


def reference() -> str:
    """Return the whole page."""
    sections = [
        INTRODUCTION,
        quality_section(),
        topic_section(),
        service_section(),
        *(node_section(node) for node in cell_nodes()),
        operator_section(),
        *(interface_section(kind) for kind in PARTS),
    ]
    return "\n".join(sections).rstrip() + "\n"


def plain(text: str) -> str:
    """Return text with what Markdown would read as marks escaped; what stands between backticks stays."""
    parts = text.split("`")
    for place in range(0, len(parts), 2):
        for mark in ("\\", "*", "_", "|"):
            parts[place] = parts[place].replace(mark, f"\\{mark}")
        parts[place] = parts[place].replace("<", "&lt;")
    return "`".join(parts)


def code(text: object) -> str:
    """Return text as code."""
    return f"`{text}`"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table with a blank line after it."""
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows), ""])


def type_link(type_name: str) -> str:
    """Return a type as code, our own ones linked to where they are on this page."""
    package, _, name = type_name.rpartition("/")
    known = package.startswith(PACKAGE)
    return f"[`{type_name}`](#{name.lower()})" if known else code(type_name)


def quality_section() -> str:
    """Return the QoS profiles."""
    rows = [
        (code(each.name), each.reliability, each.durability, str(each.depth), plain(each.purpose))
        for each in qualities().values()
    ]
    return (
        "## Quality of service\n\nFour profiles, all keep the last messages; there are no others. Services and the "
        "action have the profiles of ROS 2.\n\n" + table(("profile", "reliability", "durability", "depth", "for"), rows)
    )


def named(ends: Iterable[tuple[str, Endpoint]], with_quality: bool = True) -> str:
    """Return who has an end of something, each with its quality; ``*``: not always."""
    parts = []
    for node, end in sorted(ends):
        quality = f" ({end.quality})" if with_quality and end.quality else ""
        parts.append(f"[{plain(node)}](#{node})" + ("" if end.always else SOMETIMES) + plain(quality))
    return ", ".join(parts)


def all_ends() -> list[tuple[str, Endpoint]]:
    """Return every endpoint of the cell's nodes and of the operator with its node."""
    return [(node, end) for node in (*cell_nodes(), OPERATOR, REPLAY) for end in endpoints(node)]


def topic_section() -> str:
    """Return the table of topics."""
    every = all_ends()
    names = sorted({end.name for _, end in every if end.kind in ("publishes", "receives")} - {EVERY})
    rows = []
    for name in names:
        ends = [(node, end) for node, end in every if end.name == name and end.kind in ("publishes", "receives")]
        types = sorted({end.type_name for _, end in ends})
        if len(types) > 1:
            raise ValueError(f"topic {name} has several types: {', '.join(types)}")
        givers = [(node, end) for node, end in ends if end.kind == "publishes"]
        whose = f"every node ({plain(givers[0][1].quality)})" if name in EVERY_NODE else named(givers)
        rows.append((code(name), type_link(types[0]), whose, named(each for each in ends if each not in givers)))
    text = (
        "## Topics\n\nIn parentheses the quality of that end; \\* only for a while or under a parameter. Nodes with "
        "`use_sim_time` receive `/clock` as well. `recorder_node` receives every topic that somebody publishes, "
        "`player_node` and `./handover replay` publish those of a bag, with the quality that was recorded.\n\n"
    )
    return text + table(("topic", "type", "published by", "received by"), rows)


def service_section() -> str:
    """Return the tables of services and actions."""
    every = all_ends()
    parts = []
    for title, kinds, heads in (
        ("Services", ("serves", "asks"), ("service", "type", "served by", "asked by")),
        ("Actions", ("executes", "commands"), ("action", "type", "executed by", "commanded by")),
    ):
        rows = []
        for name in sorted({end.name for _, end in every if end.kind == kinds[0]}):
            ends = [(node, end) for node, end in every if end.name == name]
            rows.append(
                (
                    code(name),
                    type_link(ends[0][1].type_name),
                    named((each for each in ends if each[1].kind == kinds[0]), False),
                    named((each for each in ends if each[1].kind == kinds[1]), False),
                )
            )
        parts.append(f"## {title}\n\n" + table(heads, rows))
    usual = ", ".join(code(f"~/{name}") for name in (*PARAMETER_SERVICES, TYPE_SERVICE))
    return parts[0] + f"\nEvery node has the services of rclpy too: {usual}.\n\n" + parts[1]


def node_section(node: str) -> str:
    """Return what one node does, says and takes."""
    text = f"## {node}\n\n{summary(node)}\n\n" + endpoint_list(node)
    specs = parameters(node)
    rows = [
        (
            code(spec.name),
            type_name(spec.default),
            code(shown(spec.default)),
            limits(spec),
            "at start" if spec.read_only else "any time",
            plain(spec.description),
        )
        for spec in specs
    ]
    return text + table(("parameter", "type", "default", "allowed", "set", "meaning"), rows)


def operator_section() -> str:
    """Return what the commands of the terminal do in the graph."""
    text = f"## {OPERATOR}\n\nThe node of `./handover demo`. {summary(OPERATOR)}\n\n" + endpoint_list(OPERATOR)
    text += f"## {REPLAY}\n\nThe node of `./handover replay`. {summary(REPLAY)}\n\n" + endpoint_list(REPLAY)
    return text.rstrip("\n") + "\n"


def endpoint_list(node: str) -> str:
    """Return a node's ends as a list, by kind."""
    lines = []
    for kind, title in KIND_TITLES.items():
        names = [
            "every topic" if end.name == EVERY else code(end.name) + ("" if end.always else SOMETIMES)
            for end in endpoints(node)
            if end.kind == kind and not (kind == "publishes" and end.name in EVERY_NODE)
        ]
        if names:
            lines.append(f"- {title}: {', '.join(names)}")
    return "\n".join([*lines, "", ""])


def type_name(value: object) -> str:
    """Return a parameter's type as ROS calls it."""
    if isinstance(value, (list, tuple)):
        return f"{TYPES[type(value[0])]} array"
    return TYPES[type(value)]


def shown(value: object) -> str:
    """Return a default as YAML has it."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(shown(each) for each in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value or '""'
    return repr(value)


def limits(spec: Any) -> str:
    """Return which values a parameter takes."""
    if spec.choices:
        return ", ".join(code(shown(choice)) for choice in spec.choices)
    if spec.minimum is None and spec.maximum is None:
        return ""
    low = "" if spec.minimum is None else f"{spec.minimum:.10g}"
    high = "" if spec.maximum is None else f"{spec.maximum:.10g}"
    return f"{low} to {high}"


def interface_section(kind: str) -> str:
    """Return all messages, services or actions of the package."""
    titles = {"msg": "Messages", "srv": "Service types", "action": "Action types"}
    return f"## {titles[kind]}\n\n" + "\n".join(interface_text(each) for each in interfaces(kind))


def interface_text(interface: Interface) -> str:
    """Return one interface: its text and a table for each of its parts."""
    text = f"### {interface.name}\n\n`{interface.full_name}`"
    text += f": {plain(interface.text)}\n" if interface.text else "\n"
    for title, rows in zip(PARTS[interface.kind], interface.parts):
        fields = [row for row in rows if not row.value]
        constants = [row for row in rows if row.value]
        if title and not rows:
            text += f"\n{title}: nothing.\n"
        if fields:
            head = f"{title.lower()} field" if title else "field"
            text += "\n" + table((head, "type", "meaning"), [field_row(row) for row in fields])
        if constants:
            text += "\n" + table(("constant", "value", "meaning"), [constant_row(row) for row in constants])
    return text


def meaning(row: Row) -> str:
    """Return a row's comment, with the one above it in front."""
    return plain(" ".join(part for part in (row.heading and f"({row.heading})", row.text) if part))


def field_row(row: Row) -> tuple[str, str, str]:
    """Return a field's cells."""
    own = row.type_name.removesuffix("[]")
    known = "/" not in own and own[:1].isupper()
    type_text = f"[`{row.type_name}`](#{own.lower()})" if known else code(row.type_name)
    return code(row.name), type_text, meaning(row)


def constant_row(row: Row) -> tuple[str, str, str]:
    """Return a constant's cells."""
    return code(row.name), code(row.value), meaning(row)


def outdated() -> list[Path]:
    """Return the files that are not what the source says."""
    return [
        path
        for path, text in ((REFERENCE, reference()), (POLICY, policy()))
        if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]


def main(arguments: Sequence[str]) -> int:
    """Write both files, or with ``--check`` only compare."""
    if list(arguments) not in ([], ["--check"]):
        print(f"usage: {COMMAND} [--check]", file=sys.stderr)
        return 2
    found = [path.relative_to(REPOSITORY) for path in outdated()]
    if arguments and found:
        print(f"not what the source says: {', '.join(map(str, found))}; run {COMMAND}", file=sys.stderr)
        return 1
    if not arguments:
        REFERENCE.write_text(reference(), encoding="utf-8")
        POLICY.write_text(policy(), encoding="utf-8")
        print(f"written: {', '.join(map(str, found)) or 'nothing, all is up to date'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

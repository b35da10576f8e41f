"""The SROS2 policy of the cell: allowed is exactly what the nodes say and listen to in the source."""

from __future__ import annotations

from collections.abc import Iterable
from xml.sax.saxutils import escape, quoteattr

from graph_scan import EVERY, OPERATOR, REPLAY, Endpoint, cell_nodes, endpoints

from handover_ros.bags.replay import COMMANDS, OWN

ROOT = "/handover"
HEADER = """<?xml version="1.0" encoding="UTF-8"?>
<!--
  Who may say what, for `ros2 security create_permission KEYSTORE ENCLAVE config/sros2_policy.xml` (docs/deployment.md).
  Written by docs/make_reference.py from the source; a test compares. What is not listed is denied.
  /handover: all nodes of one machine. /handover/NODE: one node. /handover/operator: a terminal, and ./handover demo.
-->
"""
#: What rclpy itself serves in every node, and what a terminal may ask of each: ``ros2 param``.
PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
TYPE_SERVICE = "get_type_description"
EVERY_NODE_PUBLISHES = ("/parameter_events", "/rosout")
EVERY_NODE_RECEIVES = ("/clock", "/parameter_events")
#: Kind of endpoint -> (list, item, attribute) of the policy.
RULES = {
    "publishes": ("topics", "topic", "publish"),
    "receives": ("topics", "topic", "subscribe"),
    "serves": ("services", "service", "reply"),
    "asks": ("services", "service", "request"),
    "executes": ("actions", "action", "execute"),
    "commands": ("actions", "action", "call"),
}


def allowed(node: str) -> dict[str, set[str]]:
    """Return the names that a node may use, by kind of endpoint.

    Who records may hear all that nodes of the cell publish; who replays may publish it, but no command to a robot.
    """
    if node == OPERATOR:
        return operator_allowed()
    own = [each for each in endpoints(node) if each.name != EVERY]
    names = _with_ros(node, own)
    published = {each.absolute for name in cell_nodes() for each in endpoints(name) if each.kind == "publishes"}
    for each in set(endpoints(node)) - set(own):
        said = published - {f"/{EVERY}"}
        names[each.kind] |= said if each.kind == "receives" else said - {*COMMANDS, *OWN}
    if "/clock" in names["publishes"]:
        names["receives"].discard("/clock")
    return names


def operator_allowed() -> dict[str, set[str]]:
    """Return what a terminal may do: watch every topic, ask every service, command every action; publish nothing."""
    every = [each for node in cell_nodes() for each in endpoints(node) if each.name != EVERY]
    names = _with_ros(OPERATOR, endpoints(OPERATOR))
    # `ros2 topic echo` of a command topic too: it is published by a node of the cell.
    names["receives"] |= {each.absolute for each in every if each.kind == "publishes"} | {"/rosout"}
    names["asks"] |= {each.absolute for each in every if each.kind == "serves"}
    names["asks"] |= {f"/{node}/{service}" for node in cell_nodes() for service in (*PARAMETER_SERVICES, TYPE_SERVICE)}
    names["commands"] |= {each.absolute for each in every if each.kind == "executes"}
    return names


def _with_ros(node: str, found: Iterable[Endpoint]) -> dict[str, set[str]]:
    """Return the names of endpoints by kind, with those that rclpy makes by itself."""
    names: dict[str, set[str]] = {kind: set() for kind in RULES}
    for each in found:
        names[each.kind].add(each.absolute)
    names["publishes"] |= set(EVERY_NODE_PUBLISHES)
    names["receives"] |= set(EVERY_NODE_RECEIVES)
    if "/clock" in names["publishes"]:
        names["receives"].discard("/clock")
    if node not in (OPERATOR, REPLAY):  # they have no parameter services
        names["serves"] |= {f"/{node}/{service}" for service in (*PARAMETER_SERVICES, TYPE_SERVICE)}
    return names


def policy() -> str:
    """Return the policy as XML."""
    nodes = [*cell_nodes(), OPERATOR, REPLAY]
    lines = ['<policy version="0.2.0">', "  <enclaves>"]
    for path, members in [(ROOT, nodes), *((f"{ROOT}/{node}", [node]) for node in nodes)]:
        lines += [f"    <enclave path={quoteattr(path)}>", "      <profiles>"]
        for node in members:
            lines += _profile(node)
        lines += ["      </profiles>", "    </enclave>"]
    return HEADER + "\n".join([*lines, "  </enclaves>", "</policy>", ""])


def _profile(node: str) -> list[str]:
    """Return the lines of one node's profile."""
    lines = [f'        <profile ns="/" node={quoteattr(node)}>']
    for kind, names in allowed(node).items():
        group, item, attribute = RULES[kind]
        if names:
            lines.append(f'          <{group} {attribute}="ALLOW">')
            lines += [f"            <{item}>{escape(name)}</{item}>" for name in sorted(names)]
            lines.append(f"          </{group}>")
    return [*lines, "        </profile>"]

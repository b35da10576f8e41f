"""What every node says and listens to, read from the source: topics, services and actions with type and quality.

Nothing is run. A node is its module and what that uses of ``handover_ros.nodes``. In there every call that makes a
publisher, subscription, service, client or action is looked up, through the package's own wrappers (a function that
passes its arguments on to such a call, e.g. ``HandoverNode.serve``) and through loops over literal tables. A call that
cannot be understood is an error, so that nothing is left out silently.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
ROOM = "handover_ros.nodes"
FOLDER = REPOSITORY / "handover_ros" / "nodes"
OPERATOR = "operator"  # the node of ``./handover demo``, beside those of the cell
REPLAY = "replay"  # that of ``./handover replay``
#: In which module the nodes are that do not bear its name.
MODULES: Mapping[str, str] = {OPERATOR: "demo", REPLAY: "replay"}
#: A recorder and a player handle whatever topics there are: module and function that make such an endpoint.
EVERY_TOPIC = (("recorder_node", "begin"), ("player", "prepare"))
EVERY = "*"
RUNTIME = "runtime"

#: By the function that makes it: kind, and the places of type, name and quality among the arguments.
MAKERS: Mapping[str, tuple[str, int, int, int | None]] = {
    "create_publisher": ("publishes", 0, 1, 2),
    "create_subscription": ("receives", 0, 1, 3),
    "create_service": ("serves", 0, 1, None),
    "create_client": ("asks", 0, 1, None),
    "ActionServer": ("executes", 1, 2, None),
    "ActionClient": ("commands", 1, 2, None),
}


class ScanError(Exception):
    """The source has a call that cannot be understood from the source alone."""


@dataclass(frozen=True, order=True)
class Endpoint:
    """One end of a topic, service or action.

    Attributes:
        kind: publishes, receives, serves, asks, executes or commands.
        name: As in the source, relative to the namespace or absolute.
        type_name: e.g. ``handover_msgs/msg/MarkerFrame``.
        quality: Name of the QoS profile; empty for services and actions.
        always: False when it is made only under a condition or for a while.
    """

    kind: str
    name: str
    type_name: str
    quality: str = ""
    always: bool = True

    @property
    def absolute(self) -> str:
        """Name in the graph, without a namespace of the site."""
        return self.name if self.name.startswith("/") else f"/{self.name}"


@dataclass(frozen=True)
class Quality:
    """A QoS profile of the package."""

    name: str
    depth: int
    reliability: str
    durability: str
    purpose: str


@dataclass(frozen=True)
class Wrapper:
    """A function that passes its arguments on to a maker."""

    kind: str
    type_place: int
    name_place: int
    quality_place: int | None
    always: bool


class Module:
    """One file of the room, parsed."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path = FOLDER / f"{name}.py"
        self.tree = ast.parse(self.path.read_text(encoding="utf-8"))
        self.parents = {child: node for node in ast.walk(self.tree) for child in ast.iter_child_nodes(node)}
        self.definitions = {
            node.name: node for node in self.tree.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))
        }
        #: Local name -> (module, name there).
        self.imports = {
            alias.asname or alias.name: (node.module or "", alias.name)
            for node in ast.walk(self.tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }

    def around(self, node: ast.AST) -> Iterator[ast.AST]:
        """Yield what a node stands in, from the inside out."""
        while (parent := self.parents.get(node)) is not None:
            yield parent
            node = parent

    def where(self, node: ast.AST) -> str:
        """Return file and line for a message."""
        return f"{self.path.relative_to(REPOSITORY)}:{getattr(node, 'lineno', 0)}"


@cache
def module(name: str) -> Module:
    """Return a module of the room, parsed once."""
    return Module(name)


def cell_nodes() -> tuple[str, ...]:
    """Return the nodes of the cell and those beside it, in the order of ``cell/processes.py``."""
    tree = ast.parse((REPOSITORY / "handover_ros" / "cell" / "processes.py").read_text(encoding="utf-8"))
    given = {
        ast.unparse(node.targets[0]): tuple(ast.literal_eval(node.value))
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in ("NODES", "EXTRA_NODES")
    }
    if len(given) < 2:
        raise ScanError("handover_ros/cell/processes.py has no NODES or no EXTRA_NODES")
    return (*given["NODES"], *given["EXTRA_NODES"])


@cache
def endpoints(node: str) -> tuple[Endpoint, ...]:
    """Return all that a node publishes, receives, serves, asks, executes and commands, sorted.

    Args:
        node: A node of the cell, ``operator`` or ``replay``. A topic that only turns up at run time is named ``*``.

    Raises:
        ScanError: A call cannot be understood.
    """
    used = _used(MODULES.get(node, node))
    wrappers: dict[str, Wrapper] = {}
    while True:  # a wrapper may pass on to another one
        more = {n: w for owner, part in used for n, w in _wrappers(module(owner), part, wrappers).items()}
        if more == wrappers:
            break
        wrappers = more
    found: set[Endpoint] = set()
    for owner, part in used:
        found |= set(_endpoints(module(owner), part, wrappers))
    merged: dict[tuple[str, str, str, str], bool] = {}
    for each in found:
        key = (each.kind, each.name, each.type_name, each.quality)
        merged[key] = merged.get(key, False) or each.always
    return tuple(sorted(Endpoint(*key, always=always) for key, always in merged.items()))


def sites(node: str) -> set[tuple[str, int]]:
    """Return file and line of every call that was looked at for a node."""
    return {
        (module(owner).path.name, call.lineno)
        for owner, part in _used(MODULES.get(node, node))
        for call, called in _calls(module(owner), part)
        if called in MAKERS
    }


def summary(node: str) -> str:
    """Return what the first paragraph of a node's file says of it."""
    text = (ast.get_docstring(module(node).tree) or "").split("\n\n")[0].replace("\n", " ")
    text = text.removeprefix(f"``{node}``: ").replace("``", "`")
    return text[:1].upper() + text[1:]


@cache
def qualities() -> dict[str, Quality]:
    """Return the QoS profiles of ``nodes/runtime.py`` by name, each with the comment above it."""
    runtime = module(RUNTIME)
    lines = runtime.path.read_text(encoding="utf-8").splitlines()
    found = {}
    for node in runtime.tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            if ast.unparse(node.value.func) != "QoSProfile":
                continue
            name = ast.unparse(node.targets[0])
            given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.value.keywords}
            if given["history"] != "HistoryPolicy.KEEP_LAST":
                raise ScanError(
                    f"{runtime.where(node)}: {name} keeps {given['history']}, which the reference cannot say"
                )
            above = lines[node.lineno - 2]
            found[name] = Quality(
                name=name,
                depth=int(given["depth"]),
                reliability=_word(given["reliability"]),
                durability=_word(given.get("durability", "DurabilityPolicy.VOLATILE")),
                purpose=above.removeprefix("#:").strip() if above.startswith("#:") else "",
            )
    return found


def _word(policy: str) -> str:
    """Return ``best effort`` for ``ReliabilityPolicy.BEST_EFFORT``."""
    return policy.rpartition(".")[2].lower().replace("_", " ")


def _used(root: str) -> list[tuple[str, str]]:
    """Return (module, definition) of all that a module uses of the room; of the root everything."""
    waiting = [(root, name) for name in module(root).definitions]
    seen: list[tuple[str, str]] = []
    while waiting:
        owner, name = waiting.pop()
        if (owner, name) in seen:
            continue
        seen.append((owner, name))
        here = module(owner)
        for node in ast.walk(here.definitions[name]):
            if not isinstance(node, ast.Name):
                continue
            if node.id in here.definitions:
                waiting.append((owner, node.id))
            source, original = here.imports.get(node.id, ("", ""))
            if source.startswith(f"{ROOM}."):
                other = source.removeprefix(f"{ROOM}.")
                if original in module(other).definitions:
                    waiting.append((other, original))
            elif source == ROOM:
                raise ScanError(f"{here.where(node)}: import names from {ROOM}.{original}, not the module")
    return sorted(seen)


def _calls(here: Module, part: str) -> Iterator[tuple[ast.Call, str]]:
    """Yield the calls in a definition, each with the last part of the name that is called."""
    for node in ast.walk(here.definitions[part]):
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Attribute):
                yield node, node.func.attr
            elif isinstance(node.func, ast.Name):
                yield node, node.func.id


def _parameters(here: Module, call: ast.AST) -> tuple[ast.FunctionDef | None, list[str]]:
    """Return the function that a call stands in, a callback's outer one too, and its parameters without self."""
    for node in here.around(call):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            names = [argument.arg for argument in node.args.args]
            return node, names[1:] if names[:1] == ["self"] else names  # type: ignore[return-value]
    return None, []


def _wrappers(here: Module, part: str, known: Mapping[str, Wrapper]) -> dict[str, Wrapper]:
    """Return the functions of a definition that pass type and name on to a maker, or to a known wrapper."""
    found = {}
    for call, called in _calls(here, part):
        if called in MAKERS:
            kind, type_place, name_place, quality_place = MAKERS[called]
        elif called in known:
            inner = known[called]
            kind, type_place, name_place, quality_place = (
                inner.kind, inner.type_place, inner.name_place, inner.quality_place
            )  # fmt: skip
        else:
            continue
        if len(call.args) <= max(type_place, name_place, quality_place or 0):
            continue
        function, parameters = _parameters(here, call)
        words = [ast.unparse(argument) for argument in call.args]
        if function is None or words[type_place] not in parameters or words[name_place] not in parameters:
            continue
        name = part if function.name == "__init__" else function.name
        found[name] = Wrapper(
            kind,
            parameters.index(words[type_place]),
            parameters.index(words[name_place]),
            None if quality_place is None else parameters.index(words[quality_place]),
            kind != "asks",
        )
    return found


def _endpoints(here: Module, part: str, wrappers: Mapping[str, Wrapper]) -> Iterator[Endpoint]:
    """Yield the endpoints that a definition makes."""
    own = _wrappers(here, part, wrappers)
    for call, called in _calls(here, part):
        function, parameters = _parameters(here, call)
        if called in MAKERS:
            kind, type_place, name_place, quality_place = MAKERS[called]
            always = True
            owner = part if function is not None and function.name == "__init__" else getattr(function, "name", "")
            if owner in own and ast.unparse(call.args[name_place]) in parameters:
                continue  # the wrapper itself; its callers are looked at
        elif called in wrappers:
            wrapper = wrappers[called]
            kind, always = wrapper.kind, wrapper.always
            type_place, name_place, quality_place = wrapper.type_place, wrapper.name_place, wrapper.quality_place
            if len(call.args) > name_place and ast.unparse(call.args[name_place]) in parameters:
                continue  # a wrapper that passes on to this one
        else:
            continue
        if function is not None and (here.name, function.name) in EVERY_TOPIC and not _is_written_out(call, name_place):
            yield Endpoint(kind, EVERY, "any", "", False)
            continue
        if len(call.args) <= max(type_place, name_place, quality_place or 0):
            raise ScanError(f"{here.where(call)}: {called}: give type, name and quality by place, not by keyword")
        usual = all(not isinstance(each, ast.If) for each in here.around(call))
        usual = usual and function is not None and function.name == "__init__"
        for values in _turns(here, call):
            quality = ""
            if quality_place is not None:
                quality = ast.unparse(call.args[quality_place])
                if quality not in qualities():
                    raise ScanError(f"{here.where(call)}: quality {quality} is none of {', '.join(qualities())}")
            yield Endpoint(
                kind,
                _text(here, call.args[name_place], values),
                _type(here, call.args[type_place], values),
                quality,
                always and usual,
            )


def _is_written_out(call: ast.Call, name_place: int) -> bool:
    """Return whether the name of an endpoint is a text in the source."""
    return isinstance(call.args[name_place], ast.Constant)


def _turns(here: Module, call: ast.Call) -> list[dict[str, ast.expr]]:
    """Return the values of the loop's variables in each turn; one turn without any outside of loops."""
    turns: list[dict[str, ast.expr]] = [{}]
    for node in here.around(call):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            break
        if isinstance(node, ast.For) and isinstance(node.iter, (ast.Tuple, ast.List)):
            targets = node.target.elts if isinstance(node.target, ast.Tuple) else [node.target]
            rows = [row.elts if isinstance(node.target, ast.Tuple) else [row] for row in node.iter.elts]  # type: ignore[attr-defined]
            names = [ast.unparse(target) for target in targets]
            turns = [{**turn, **dict(zip(names, row))} for turn in turns for row in rows]
    return turns


def _text(here: Module, expression: ast.expr, values: Mapping[str, ast.expr]) -> str:
    """Return the text of an expression: a literal, a loop's variable or an f-string of these."""
    if isinstance(expression, ast.Constant) and isinstance(expression.value, str):
        return expression.value
    if isinstance(expression, ast.Name) and expression.id in values:
        return _text(here, values[expression.id], {})
    if isinstance(expression, ast.JoinedStr):
        return "".join(
            _text(here, part.value if isinstance(part, ast.FormattedValue) else part, values)
            for part in expression.values
        )
    raise ScanError(f"{here.where(expression)}: the name {ast.unparse(expression)} is not written out in the source")


def _type(here: Module, expression: ast.expr, values: Mapping[str, ast.expr]) -> str:
    """Return the interface that an expression names."""
    if isinstance(expression, ast.Name):
        if expression.id in values:
            return _type(here, values[expression.id], {})
        source, original = here.imports.get(expression.id, ("", ""))
        if source.count(".") == 1 and source.endswith((".msg", ".srv", ".action")):
            return f"{source.replace('.', '/')}/{original}"
    raise ScanError(f"{here.where(expression)}: the type {ast.unparse(expression)} is not imported by name")

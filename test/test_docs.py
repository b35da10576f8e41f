"""The documentation: the reference is what the source says, the site builds clean, what pages name is there."""

import ast
import importlib.util
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parent.parent
DOCS = SOURCE / "docs"
NODES = SOURCE / "handover_ros" / "nodes"
sys.path.insert(0, str(DOCS))

import graph_scan  # noqa: E402
import interface_files  # noqa: E402
import sros2_policy  # noqa: E402

from handover_ros.bags.replay import COMMANDS, OWN  # noqa: E402

PAGES = sorted(DOCS.glob("*.md"))
MAKER = re.compile(r"\b(create_publisher|create_subscription|create_service|create_client|ActionServer|ActionClient)\(")
ROOMS = "sim|mocap|human|robot|objects|calibration|planner|preferences|handover|cell"


def every_node():
    return [*graph_scan.cell_nodes(), graph_scan.OPERATOR, graph_scan.REPLAY]


def known_names():
    """Return all topics, services and actions, as the source has them."""
    return {end.name for node in every_node() for end in graph_scan.endpoints(node)} - {graph_scan.EVERY}


def make_reference():
    pytest.importorskip("rclpy", reason="ROS is not there")
    pytest.importorskip("handover_msgs", reason="handover_msgs is not built")
    return importlib.import_module("make_reference")


# The reference.


def test_reference_and_policy_are_what_the_source_says():
    reference = make_reference()
    stale = [str(path.relative_to(SOURCE)) for path in reference.outdated()]
    assert not stale, f"{', '.join(stale)} differ from the source; run {reference.COMMAND}"


def test_reference_has_every_name():
    reference = make_reference()
    text = (DOCS / "reference.md").read_text()
    for name in known_names():
        assert f"`{name}`" in text, f"{name} is not in the reference; run {reference.COMMAND}"
    for node in graph_scan.cell_nodes():
        section = text.split(f"\n## {node}\n")[1].split("\n## ")[0]
        assert reference.parameters(node)
        for spec in reference.parameters(node):
            assert f"| `{spec.name}` |" in section, f"parameter {spec.name} of {node}: run {reference.COMMAND}"
    for kind in interface_files.PARTS:
        for path in (SOURCE / "msg_defs" / kind).iterdir():
            assert f"`handover_msgs/{kind}/{path.stem}`" in text


def test_check_fails_on_a_topic_that_the_reference_lacks(monkeypatch, capsys):
    """A topic more in the source makes ``--check`` fail with the command to run."""
    reference = make_reference()
    real = graph_scan.endpoints
    more = graph_scan.Endpoint("publishes", "sim/something_new", "std_msgs/msg/Bool", "LATCHED")
    for module in (reference, sros2_policy):
        monkeypatch.setattr(module, "endpoints", lambda node: (*real(node), *([more] if node == "sim_node" else [])))
    assert reference.main(["--check"]) == 1
    assert reference.COMMAND in capsys.readouterr().err


# The scan misses nothing.


def test_scan_reaches_every_call_that_makes_an_endpoint():
    """Found by text alone: each line of nodes/ that makes a publisher, subscription, service, client or action."""
    lines = {
        (path.name, number)
        for path in NODES.glob("*.py")
        for number, line in enumerate(path.read_text().splitlines(), start=1)
        if MAKER.search(line) and not line.lstrip().startswith(("#", "def ", "from ", "import "))
    }
    reached = set().union(*(graph_scan.sites(node) for node in every_node()))
    assert lines == reached


def test_every_name_in_the_nodes_is_an_endpoint():
    """Whatever text in nodes/ looks like a topic's name is one that the scan found."""
    known = known_names()
    for path in sorted(NODES.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                for name in re.findall(rf"(?<![\w/~.])(?:{ROOMS})/[a-z_]+\b(?![/.])", node.value):
                    assert name in known, f"{path.name}:{node.lineno}: {name} is nothing that a node says or hears"


def test_nodes_of_launch_file_set_up_and_scan_are_the_same():
    for path in (SOURCE / "launch" / "cell.launch.py", SOURCE / "setup.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "NODES":
                named = tuple(ast.literal_eval(node.value))
                assert named == graph_scan.cell_nodes()[: len(named)]
                assert len(named) == len(graph_scan.cell_nodes()) or "recorder_node" in path.read_text()
    files = {path.stem for path in NODES.glob("*_node.py")}
    assert files == set(graph_scan.cell_nodes())


def test_readme_table_agrees_with_the_scan():
    """The README's table of the graph names for each node only what it has, each under its right kind."""
    kinds = {"pub": ("publishes",), "sub": ("receives",), "srv": ("serves",), "action": ("executes",)}
    rows = re.findall(r"^\| `(\w+_node)` \| .*? \| (.*) \|$", (SOURCE / "README.md").read_text(), re.MULTILINE)
    assert [name for name, _ in rows] == list(graph_scan.cell_nodes())
    for node, speaks in rows:
        for part in speaks.split(";"):
            kind = part.split()[0]
            has = {end.name for end in graph_scan.endpoints(node) if end.kind in kinds[kind]}
            for name in re.findall(r"`([^`]+)`", part):
                assert name in has, f"README: {node} has no {kind} {name}"


def test_types_of_a_name_agree_between_nodes():
    types = {}
    for node in every_node():
        for end in graph_scan.endpoints(node):
            assert types.setdefault(end.absolute, end.type_name) == end.type_name, f"{node}: {end.name}"


def test_whoever_asks_is_answered():
    """Each topic that is received is published, each service that is asked is served, likewise the action."""
    ends = [end for node in every_node() for end in graph_scan.endpoints(node)]
    for wanted, given in (("receives", "publishes"), ("asks", "serves"), ("commands", "executes")):
        names = {end.absolute for end in ends if end.kind == given}
        assert {end.absolute for end in ends if end.kind == wanted} <= names


def test_scan_refuses_what_it_cannot_understand(monkeypatch, tmp_path):
    """A name that is made up at run time is an error with file and line, never left out silently."""
    (tmp_path / "odd_node.py").write_text(
        "from std_msgs.msg import Bool\nclass OddNode:\n    def __init__(self):\n"
        "        self.create_publisher(Bool, self.name + '/x', LATCHED)\n"
    )
    graph_scan.qualities()  # read from the real folder, and remembered
    monkeypatch.setattr(graph_scan, "FOLDER", tmp_path)
    monkeypatch.setattr(graph_scan, "REPOSITORY", tmp_path)
    with pytest.raises(graph_scan.ScanError, match=r"odd_node\.py:4: the name self\.name"):
        graph_scan.endpoints("odd_node")


# Messages.


def test_interface_files_are_read_whole(tmp_path):
    path = tmp_path / "Thing.srv"
    path.write_text(
        "# does it;\n# well\nstring name   # whose\n              # and when\n\n# of all below\nfloat64[] x  # [m]\n"
        "uint8 BAD=2  # no\n---\nbool success\n"
    )
    found = interface_files.parse(path)
    assert (found.full_name, found.text) == ("handover_msgs/srv/Thing", "does it; well")
    request, response = found.parts
    assert [(row.type_name, row.name, row.value) for row in request] == [
        ("string", "name", ""),
        ("float64[]", "x", ""),
        ("uint8", "BAD", "2"),
    ]
    assert [row.text for row in request] == ["whose and when", "[m]", "no"]
    assert request[1].heading == "of all below"
    assert [row.name for row in response] == ["success"]
    path.write_text("string\n---\n")
    with pytest.raises(interface_files.InterfaceError, match=r"Thing\.srv:1"):
        interface_files.parse(path)


def test_fields_are_those_of_the_built_messages():
    """What ROS made of the same files has the same fields."""
    for kind in interface_files.PARTS:
        built = pytest.importorskip(f"handover_msgs.{kind}", reason="handover_msgs is not built")
        for interface in interface_files.interfaces(kind):
            made = getattr(built, interface.name)
            for part, rows in zip(interface_files.PARTS[kind], interface.parts):
                fields = (getattr(made, part) if part else made).get_fields_and_field_types()
                names = [row.name for row in rows if not row.value]
                assert names == [name for name in fields if name != "structure_needs_at_least_one_member"]


# The security policy.


def granted(path):
    """Return (kind, name) of all that an enclave of the policy allows, by node."""
    root = ElementTree.parse(SOURCE / "config" / "sros2_policy.xml").getroot()
    rules = {(group, attribute): kind for kind, (group, _, attribute) in sros2_policy.RULES.items()}
    found = {}
    for profile in root.findall(f"./enclaves/enclave[@path='{path}']/profiles/profile"):
        names = found.setdefault(profile.get("node"), set())
        for group in profile:
            (attribute,) = group.keys()
            assert group.get(attribute) == "ALLOW"
            names |= {(rules[group.tag, attribute], item.text) for item in group}
    return found


def published():
    """Return the names of all topics that nodes of the cell publish."""
    ends = [end for node in graph_scan.cell_nodes() for end in graph_scan.endpoints(node)]
    return {end.absolute for end in ends if end.kind == "publishes" and end.name != graph_scan.EVERY}


def test_a_replay_may_not_command_a_robot():
    for node in ("player_node", "replay"):
        assert not {("publishes", name) for name in COMMANDS} & granted(f"/handover/{node}")[node]


@pytest.mark.parametrize("node", graph_scan.cell_nodes())
def test_policy_grants_each_node_exactly_what_it_has(node):
    """Nothing is denied that the node does, and nothing allowed beyond that but what rclpy does in every node."""
    grants = granted(f"/handover/{node}")[node]
    has = {(end.kind, end.absolute) for end in graph_scan.endpoints(node) if end.name != graph_scan.EVERY}
    for end in graph_scan.endpoints(node):
        if end.name == graph_scan.EVERY:  # of a bag, or for one: what nodes of the cell publish
            has |= {(end.kind, name) for name in published()} if end.kind == "receives" else set()
            has |= {(end.kind, name) for name in published() - {*COMMANDS, *OWN}} if end.kind == "publishes" else set()
    has -= {("receives", "/clock")}
    assert has <= grants
    own = {("publishes", name) for name in ("/rosout", "/parameter_events")}
    own |= {("receives", name) for name in ("/clock", "/parameter_events")}
    assert {each for each in grants - has if not each[1].startswith(f"/{node}/")} <= own
    assert granted("/handover")[node] == grants


def test_policy_lets_a_terminal_watch_and_ask_but_not_command_the_robot():
    grants = granted("/handover/operator")["operator"]
    ends = [end for node in graph_scan.cell_nodes() for end in graph_scan.endpoints(node)]
    every = {(end.kind, end.absolute) for end in ends if end.name != graph_scan.EVERY}
    assert {("receives", name) for kind, name in every if kind == "publishes"} <= grants
    assert {("asks", name) for kind, name in every if kind == "serves"} <= grants
    assert {("commands", name) for kind, name in every if kind == "executes"} <= grants
    assert {(end.kind, end.absolute) for end in graph_scan.endpoints("operator")} <= grants
    assert {name for kind, name in grants if kind == "publishes"} == {"/rosout", "/parameter_events"}


# The pages.


def test_gallery_has_the_captions_of_the_studies():
    sys.modules.pop("make_figures", None)
    make_reference()
    figures = importlib.import_module("make_figures")
    assert figures.PAGE.read_text() == figures.page(), f"figures.md is out of date; run {figures.COMMAND} --page"


def test_site_builds_without_warnings(tmp_path):
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    answer = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, timeout=120, check=False)
    assert answer.returncode == 0, answer.stderr
    assert "WARNING" not in answer.stderr
    for page in PAGES:
        assert list((tmp_path / "site").glob(f"{'' if page.stem == 'index' else page.stem + '/'}index.html")), page.name
    assert not list((tmp_path / "site").rglob("*.py"))


@pytest.mark.parametrize("page", [*PAGES, SOURCE / "README.md"], ids=lambda page: page.name)
def test_links_and_pictures_are_there(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), f"{page.name}: {target} is not there"
        if anchor:
            assert anchor in anchors(file), f"{page.name}: {file.name} has no heading {anchor}"


def anchors(page):
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}


def test_files_that_pages_name_are_there():
    for page in PAGES:
        text = page.read_text()
        for name in re.findall(r"`((?:handover_ros|config|docs|launch|msg_defs|test)/[\w./]+\.\w+)`", text):
            if "my_" not in name and "candle" not in name:
                assert (SOURCE / name).is_file(), f"{page.name}: {name} is not there"
    for name in re.findall(r"`(\w+/\w+\.py)`", (DOCS / "algorithms.md").read_text()):
        assert (SOURCE / "handover_ros" / name).is_file(), f"algorithms.md: {name} is not there"


def test_commands_of_the_pages_exist():
    """What a page's command names exists: services and the action with that type, topics, ./handover commands."""
    ends = {end.absolute: end for node in graph_scan.cell_nodes() for end in graph_scan.endpoints(node)}
    commands = set(re.findall(r"^\| `\./handover (\w+)", (SOURCE / "README.md").read_text(), re.MULTILINE))
    for page in PAGES:
        blocks = "\n".join(re.findall(r"```bash\n(.*?)```", page.read_text(), re.DOTALL))
        for name, kind in re.findall(r"ros2 (?:service call|action send_goal) (\S+) ([\w/]+)", blocks):
            assert ends[name].type_name == kind, f"{page.name}: {name} is a {ends[name].type_name}"
        for name in re.findall(r"ros2 topic (?:echo|hz) (\S+)", blocks):
            assert ends[name].kind in ("publishes", "receives"), f"{page.name}: {name}"
        assert set(re.findall(r"^\./handover (\w+)", blocks, re.MULTILINE)) <= commands, page.name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_in_python_and_yaml_are_valid(page):
    yaml = pytest.importorskip("yaml")
    for language, block in re.findall(r"```(python|yaml)\n(.*?)```", page.read_text(), re.DOTALL):
        if language == "python":
            compile(block, page.name, "exec")
        else:
            assert isinstance(yaml.safe_load(block), dict)


def test_object_of_the_tutorial_is_accepted(tmp_path):
    block = re.search(r"```yaml\n(# config/objects/candle.*?)```", (DOCS / "researcher.md").read_text(), re.DOTALL)
    path = tmp_path / "candle.yaml"
    path.write_text(block[1])
    from handover_ros.objects.catalogue import load_object

    assert load_object(str(path)).human_grasps


def test_messages_of_troubleshooting_are_those_of_the_code():
    """Every fixed part of a quoted message stands in a text of the source."""
    texts = set()
    for path in [*(SOURCE / "handover_ros").rglob("*.py"), *(SOURCE / "bootstrap").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.add(node.value)
    whole = "\n".join(texts)
    quoted = re.findall(r"^\| `([^`]+)` \|", (DOCS / "troubleshooting.md").read_text(), re.MULTILINE)
    assert len(quoted) > 50
    for message in quoted:
        for piece in message.split("…"):
            assert piece.strip() in whole, f"troubleshooting.md: the source has no {piece.strip()!r} (of {message!r})"

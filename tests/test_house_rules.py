"""Rules that the whole package keeps: import order, final classes, documentation, size."""

import ast
import builtins
import dis
import functools
import importlib
import inspect
import pkgutil
import re
import types
from collections import Counter
from pathlib import Path

import equinox as eqx
import pytest
from jaxtyping import TypeCheckError

import eoi_jax
from eoi_jax._checks import check
from eoi_jax._display import Result

PACKAGE = Path(eoi_jax.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
# A room may import from itself and from those below it in this list, and all of them from the
# ground: the files at the root of the package whose names begin with an underscore.
ROOMS = (
    "cli",
    "report",
    "discovery",
    "comparison",
    "uncertainty",
    "refinement",
    "estimation",
    "simulation",
    "models",
    "data",
    "compiler",
)
RANK = {name: i for i, name in enumerate(ROOMS)}
# Names by which users know some rooms: they hold what the room does, and nothing of the package
# imports from them but the package itself.
ALIASES = {"comparators", "effects", "engines", "observers", "plants"}


@functools.cache
def parsed(path):
    """The syntax tree of a file."""
    return ast.parse(path.read_text())


def of_each_file(rule):
    """A rule of files as one test, which says of each file that breaks it where."""

    def test():
        broken = {}
        for path in FILES:
            try:
                rule(path)
            except AssertionError as error:
                broken[str(path.relative_to(PACKAGE))] = str(error)
        assert not broken, "\n".join(f"{name}: {why}" for name, why in broken.items())

    test.__name__, test.__doc__ = rule.__name__, rule.__doc__
    return test


def global_names(code):
    """Names that a module's functions read from it."""
    for instruction in dis.get_instructions(code):
        if instruction.opname == "LOAD_GLOBAL":
            yield instruction.argval
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from global_names(part)


@of_each_file
def test_every_name_exists(path):
    """The linters are told not to look: names of axes would be undefined to them."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    module = importlib.import_module(".".join(part for part in parts if part != "__init__"))
    names = set(global_names(compile(path.read_text(), str(path), "exec")))
    assert names <= {*vars(module), *vars(builtins)}


def own_imports(tree):
    """What a module imports of the package, anywhere in it: names without the package's."""
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "eoi_jax":
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.startswith("eoi_jax.")]
        for name in names:
            yield name.removeprefix("eoi_jax.")


def part_of(path):
    relative = path.relative_to(PACKAGE)
    return relative.parts[0].removesuffix(".py")


@of_each_file
def test_imports_point_down_only(path):
    part = part_of(path)
    if part in {"__init__", *ALIASES}:
        return
    assert part in RANK or part.startswith("_"), f"{part} is no room"
    for name in own_imports(parsed(path)):
        other = name.split(".")[0]
        if not other.startswith("_"):
            assert RANK[other] >= RANK.get(part, len(ROOMS)), f"{part} imports from {other}"


def test_no_two_modules_import_each_other():
    """Not through others either: the modules can be read one after the other."""
    modules = {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
        for path in FILES
    }
    del modules["__init__"]
    needs = {}
    for name, path in modules.items():
        found = own_imports(parsed(path))
        whole = {one if one in modules else one.rpartition(".")[0] for one in found}
        needs[name] = {one for one in whole if one in modules and one != name}
    while needs:
        free = [name for name, others in needs.items() if not others & needs.keys()]
        assert free, f"they import each other: {sorted(needs)}"
        for name in free:
            del needs[name]


@of_each_file
def test_annotations_stay_objects(path):
    """`from __future__ import annotations` would switch the run-time shape checks off."""
    imported = [node for node in ast.walk(parsed(path)) if isinstance(node, ast.ImportFrom)]
    assert not [node for node in imported if node.module == "__future__"]


@of_each_file
def test_the_library_does_not_print(path):
    calls = [node for node in ast.walk(parsed(path)) if isinstance(node, ast.Call)]
    assert not [
        call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"
    ]


def docstring_lines(node):
    """Lines that the docstrings of a module, or of one function, take."""
    total = 0
    for part in ast.walk(node):
        if isinstance(
            part, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        ) and (ast.get_docstring(part) is not None):
            first = part.body[0]
            total += (first.end_lineno or first.lineno) - first.lineno + 1
    return total


@of_each_file
def test_modules_and_functions_are_short(path):
    text = path.read_text()
    tree = parsed(path)
    assert len(text.splitlines()) - docstring_lines(tree) <= 500
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            size = (node.end_lineno or node.lineno) - node.lineno + 1 - docstring_lines(node)
            assert size <= 60, f"{node.name}: {size} lines"


@of_each_file
def test_there_are_no_option_dicts(path):
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("check_"):
            if any("wraps" in ast.unparse(one) for one in node.decorator_list):
                continue  # it takes what the function does that it stands for
            assert node.args.kwarg is None, f"{node.name} takes **{node.args.kwarg.arg}"


def modules():
    for found in pkgutil.walk_packages([str(PACKAGE)], "eoi_jax."):
        yield importlib.import_module(found.name)


def classes():
    return {
        item
        for module in modules()
        for _, item in inspect.getmembers(module, inspect.isclass)
        if item.__module__.startswith("eoi_jax")
    }


def test_classes_are_abstract_or_final():
    """All fields and methods of a final class stand in one place."""
    for item in classes():
        for parent in item.__mro__[1:]:
            if not parent.__module__.startswith("eoi_jax"):
                continue
            if parent is Result:  # without fields; it asks others to print, draw and save
                continue
            assert parent.__name__.startswith("Abstract"), (
                f"{item.__name__} extends {parent.__name__}"
            )
            assert inspect.isabstract(parent)


def test_abstract_modules_have_no_fields_of_their_own():
    for item in classes():
        if issubclass(item, eqx.Module) and item.__name__.startswith("Abstract"):
            fields = {
                key: value
                for key, value in inspect.get_annotations(item).items()
                if "AbstractVar" not in str(value)
            }
            assert not fields, item.__name__


PUBLIC = (
    "eoi_jax",
    "eoi_jax.comparators",
    "eoi_jax.effects",
    "eoi_jax.observers",
    "eoi_jax.plants",
    "eoi_jax.estimation.regression",
    "eoi_jax.data.excitation",
)


def exports():
    for name in PUBLIC:
        module = importlib.import_module(name)
        for key, item in inspect.getmembers(module):
            if key.startswith("_") or inspect.ismodule(item):
                continue
            if getattr(item, "__module__", "").startswith("eoi_jax"):
                if (
                    inspect.isfunction(item)
                    and name.endswith("excitation")
                    and item.__module__ != name
                ):
                    continue
                yield pytest.param(item, id=f"{name}.{key}")


def arguments(item):
    return [key for key in inspect.signature(item).parameters if key not in ("self", "cls")]


@pytest.mark.parametrize("item", list(exports()))
def test_every_export_is_documented(item):
    text = inspect.getdoc(item) or ""
    assert text
    if inspect.isclass(item):
        if not inspect.isabstract(item) and not issubclass(item, Warning) and arguments(item):
            assert "Args:" in text or "Attributes:" in text
            if "Args:" in text:
                for key in arguments(item):
                    assert key in text, key
        return
    if arguments(item):
        assert "Args:" in text
        for key in arguments(item):
            assert f"{key}" in text.split("Args:")[1], key
    if inspect.signature(item).return_annotation not in (None, inspect.Signature.empty):
        assert "Returns:" in text


@pytest.mark.parametrize(
    "item", [case.values[0] for case in exports() if inspect.isclass(case.values[0])]
)
def test_every_public_method_has_a_docstring(item):
    for key, member in vars(item).items():
        if key.startswith("_") or not (inspect.isfunction(member) or isinstance(member, property)):
            continue
        assert inspect.getdoc(member), f"{item.__name__}.{key}"


@pytest.mark.parametrize("room", ["", "cli"])
def test_the_api_is_a_list_of_explicit_names(room):
    """The names that are imported at their first use; each is found where the stub says."""
    package = importlib.import_module(f"eoi_jax.{room}".rstrip("."))
    for node in ast.parse((PACKAGE / room / "__init__.pyi").read_text()).body:
        assert isinstance(node, ast.ImportFrom)
        assert all(alias.asname == alias.name for alias in node.names)
        assert all(hasattr(package, alias.name) for alias in node.names)


# Libraries that take long to import and that many an estimate does without; parts of JAX that not
# every version or build has.
IN_FUNCTIONS = {
    *("diffrax", "h5py", "jinja2", "latex2mathml", "markupsafe", "matplotlib", "pandas"),
    *("optimistix", "pyarrow", "rich", "scipy", "xarray", "zarr"),
    *("jax._src.xla_bridge", "jax.experimental.pallas"),
}


@of_each_file
def test_imports_stand_at_the_top(path):
    for function in ast.walk(parsed(path)):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        for node in ast.walk(function):
            names = []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or "."]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                assert {name, name.split(".")[0]} & IN_FUNCTIONS, f"{function.name} imports {name}"


def test_the_root_of_the_package_is_short():
    """What is there besides the rooms: the ground, and the names that users import from."""
    entries = [path for path in PACKAGE.iterdir() if path.name not in ("__pycache__", "py.typed")]
    assert sum(path.is_file() for path in entries) <= 14
    assert sum(path.is_dir() for path in entries) <= 11


def _is_number(value):
    if isinstance(value, ast.Constant):
        return isinstance(value.value, int | float) and not isinstance(value.value, bool)
    if isinstance(value, ast.UnaryOp):
        return _is_number(value.operand)
    if isinstance(value, ast.BinOp):
        return _is_number(value.left) and _is_number(value.right)
    is_sequence = isinstance(value, ast.Tuple | ast.List)
    return is_sequence and bool(value.elts) and all(map(_is_number, value.elts))


def test_numbers_that_decide_are_fields_or_arguments():
    """Facts of formats and machines may stay private; discovery's rules wait for its rewrite."""
    private = []
    for path in FILES:
        if path.is_relative_to(PACKAGE / "discovery"):
            continue
        for node in parsed(path).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or not _is_number(node.value):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name.id for target in targets for name in ast.walk(target)
                     if isinstance(name, ast.Name)]  # fmt: skip
            private += [f"{path.name}: {name}" for name in names if name.startswith("_")]
    assert len(private) <= 20, private


def test_the_map_of_the_package_names_what_is_there():
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text()
    places = re.findall(r"`((?:[a-z_]+/)+[a-z_]+\.py)(?:: ([\w.]+))?`", text)
    assert len(places) > 30
    for path, name in places:
        files = [root / path for root in (PACKAGE, PACKAGE.parent, PACKAGE / "estimation")]
        file = next((file for file in files if file.is_file()), None)
        assert file is not None, path
        if name:
            nodes = ast.walk(ast.parse(file.read_text()))
            defined = {
                node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)
            }
            assert set(name.split(".")) <= defined, f"{path}: {name}"


# Articles, pronouns, conjunctions, prepositions, quantifiers and participles that say of a thing
# only that there is one.
FUNCTION_WORDS = frozenset(
    re.findall(
        r"\w+",
        """
        about above again alike all almost alone along also always an and another any anew apart
        around as aside at away back because been before behind below beside besides between beyond
        both but by came come done down each either else enough even ever every few for found from
        gave given gone got had half has have he held her here hers him his how however if in indeed
        inside instead into is it its itself just kept known least left less like little lone made
        many mine more moreover most much must my near nearly neither never no none nor not nothing
        now of off often on once one ones only or other others otherwise our ours out outside over
        own per perhaps put rather ready rest said same seen several shall she should shown since so
        some something still such taken tell than that the their theirs them themselves then there
        therefore these they thing things this those though through thus to together told too toward
        tried under unless until up upon us very was way we well were what whatever when where
        whether which while who whole whom whose why will with within without would yet you your
        yours
        """,
    )
)
# Of Python, and of the interface of effects and of `discover`.
PUBLIC_NAMES = {"all", "any", "Any", "at", "most", "seen"}
# Attributes and arguments of Python and NumPy, and public fields of results.
PUBLIC_FIELDS = PUBLIC_NAMES | {"and", "back", "done", "not", "on", "ones", "or", "out", "over"}
PUBLIC_FIELDS |= {"tell", "where", "which", "along", "before", "found", "held_out", "others"}
PUBLIC_FIELDS |= {"through", "why"}


def identifiers(tree):
    """Names, and which of them are allowed whatever they say."""
    fields = {
        id(item.target)
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for item in node.body
        if isinstance(item, ast.AnnAssign)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id, PUBLIC_FIELDS if id(node) in fields else PUBLIC_NAMES
        elif isinstance(node, ast.arg):
            yield node.arg, PUBLIC_NAMES
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, PUBLIC_FIELDS
        elif isinstance(node, ast.Attribute):
            yield node.attr, PUBLIC_FIELDS
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, PUBLIC_NAMES


def test_names_say_what_a_thing_is():
    """Fewer than one use in two hundred is a function word."""
    uses, words = 0, Counter()
    for path in FILES:
        for name, allowed in identifiers(parsed(path)):
            uses += 1
            word = name.strip("_").lower()
            if word in FUNCTION_WORDS and name not in allowed and name != "__all__":
                words[f"{path.relative_to(PACKAGE)}: {name}"] += 1
    share = words.total() / uses
    assert share < 0.005, f"{share:.2%}: {words.most_common(20)}"


def test_shapes_are_checked_at_run_time():
    """Else every annotation in the tests is decoration."""
    with pytest.raises(TypeCheckError):
        check("yes", "name", "rule", 1)  # type: ignore[arg-type]

"""Conversion of tables of a TOML or JSON file to msgspec Structs, with errors that name the field.

msgspec converts them too, but its messages contain neither the key of a dictionary nor the value.
"""

import re
from collections.abc import Sequence
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import msgspec

from eoi_jax._checks import check, check_choice


def struct(kind: type[msgspec.Struct], table: Any, name: str = "") -> Any:
    """The Struct of a table, built field by field.

    Args:
        kind: class of the Struct.
        table: the table, as read from the file.
        name: of the table, placed before its keys in messages; "" for the top level of a file.

    Raises:
        ValueError: a key is unknown (the known ones are listed), a value is missing, of the wrong
            type or out of range.
    """
    return _table((kind,), table, name)


def _table(kinds: Sequence[Any], table: Any, name: str) -> Any:
    """The Struct of a table, of that class among `kinds` that the table's key `kind` names."""
    check(isinstance(table, dict), name, "must be a table", table)
    kind, table = kinds[0], dict(table)
    if kind.__struct_config__.tag is not None:
        by_tag = {variant.__struct_config__.tag: variant for variant in kinds}
        tag = table.pop("kind", None)
        check(tag is not None, f"{name}.kind", f"must be one of {', '.join(by_tag)}", "nothing")
        check_choice(f"{name}.kind", str(tag), by_tag)
        kind = by_tag[tag]
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    keys = [*(["kind"] if len(kinds) > 1 else []), *fields]
    for key in table:
        check_choice(f"a key of [{name}]" if name else "a key of the config", key, keys)
    values = {}
    for key, field in fields.items():
        where = f"{name}.{key}" if name else key
        check(key in table or not field.required, where, "must be given", "nothing")
        if key in table:
            values[key] = _value(field.type, table[key], where)
    return kind(**values)


def _value(annotation: Any, value: Any, name: str) -> Any:
    members = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else [annotation]
    kinds = [m for m in members if isinstance(m, type) and issubclass(m, msgspec.Struct)]
    plain = [m for m in members if m not in kinds and m is not type(None)]
    if kinds and (isinstance(value, dict) or not plain):
        return _table(kinds, value, name)
    if kinds:
        annotation = Union[tuple(plain)]  # noqa: UP007 - of a list
    words = [m for m in plain if get_origin(m) is Literal]
    if words and len(plain) == 2:  # a word for all, or a table of words
        annotation = next(m for m in plain if (m in words) != isinstance(value, dict))
    if get_origin(annotation) is tuple and _is_table(get_args(annotation)[0]):
        check(isinstance(value, list), name, "must be a list of tables", value)
        item = get_args(annotation)[0]
        return tuple(_value(item, element, f"{name}[{i}]") for i, element in enumerate(value))
    if get_origin(annotation) is dict:
        check(isinstance(value, dict), name, "must be a table", value)
        item = get_args(annotation)[1]
        return {key: _value(item, element, f"{name}.{key}") for key, element in value.items()}
    if get_origin(annotation) is Literal:
        check_choice(name, str(value), get_args(annotation))
    try:
        return msgspec.convert(value, annotation)
    except msgspec.ValidationError as error:
        rule, place = _rule_and_place(str(error))
        metadata = getattr(annotation, "__metadata__", ()) if isinstance(value, str) else ()
        words = [meta.description for meta in metadata if meta.description]  # what a pattern asks
        check(False, name + place, f"must be {words[0]}" if words else rule, repr(value))


def _is_table(annotation: Any) -> bool:
    if get_origin(annotation) is dict:
        return True
    return isinstance(annotation, type) and issubclass(annotation, msgspec.Struct)


_WORDS = {
    "`str`": "a text",
    "`float`": "a number",
    "`int`": "a whole number",
    "`array`": "a list",
    "`float | array`": "a number or a list of numbers",
    "`float | str`": "a number or a text",
    "`str | array`": "a text or a list of texts",
    "`str | array | null`": "a text or a list of texts",
    "`float | object`": "a number or a table of numbers",
    "`str | null`": "a text",
    "`int | null`": "a whole number",
    "`float | null`": "a number",
    "`array | null`": "a list",
}


def _rule_and_place(message: str) -> tuple[str, str]:
    """Rule and place in the value from a message "Expected `float` > 0.0 - at `$[1]`"."""
    message, _, place = message.partition(" - at `$")
    expected = re.sub(r"^Expected |, got .*$", "", message)
    for word, plain in _WORDS.items():
        expected = expected.replace(word, plain)
    return f"must be {expected}", place.rstrip("`")

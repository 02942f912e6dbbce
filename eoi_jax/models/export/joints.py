"""Joints of robot descriptions, URDF and MJCF: attributes of joints set in the text of the file.

The text is edited where an attribute stands, at the places that the XML parser (expat) gives;
everything else keeps every byte: comments, order, white space, line ends.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from eoi_jax._checks import check, check_choice

# Of a joint that turns, and of one that slides.
_ANGULAR = {"damping": "N m s/rad", "friction": "N m", "armature": "kg m²", "stiffness": "N m/rad"}
_LINEAR = {"damping": "N s/m", "friction": "N", "armature": "kg", "stiffness": "N/m"}
_QUANTITIES = {"frictionloss": "friction"}
ATTRIBUTES = {
    "URDF": ("damping", "friction"),
    "MJCF": ("damping", "frictionloss", "armature", "stiffness"),
}
_ROOTS = {"robot": "URDF", "mujoco": "MJCF", "mujocoinclude": "MJCF"}
# In these a `joint` is a class of defaults, or refers to a joint.
_REFERENCES = {"default", "equality", "tendon", "actuator", "sensor", "contact", "keyframe"}
_IMMOBILE = ("fixed", "floating", "planar", "free")
_SLIDING = ("prismatic", "slide")
_ATTRIBUTE = re.compile(rb"""([^\s=/<>"']+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass
class Joint:
    """A joint of a file.

    Attributes:
        name: of the joint.
        kind: its type; "" where the file leaves it to its default.
        start: place of its start tag.
        children: places of the start tags of what it holds, by name.
        first_child, end: places of its first child's start tag, and of its end tag; -1: none.
    """

    name: str
    kind: str
    start: int
    children: dict[str, int] = field(default_factory=dict)
    first_child: int = -1
    end: int = -1


@dataclass(frozen=True)
class RobotFile:
    """A robot description.

    Attributes:
        content: its bytes.
        language: ``"URDF"`` or ``"MJCF"``.
        joints: by name.
        includes: files that it includes, which are not read.
        default_types: whether its default classes give joints a type.
    """

    content: bytes
    language: str
    joints: dict[str, Joint]
    includes: tuple[str, ...]
    default_types: bool

    def check_joint(self, name: str) -> None:
        """Check that a joint is in the file, and moves.

        Args:
            name: of the joint.

        Raises:
            ValueError: there is none, or it has no axis.
        """
        if self.includes and name not in self.joints:
            rule = f"must be a joint of this file ({', '.join(self.joints) or 'none'})"
            advice = f"It includes {', '.join(self.includes)}: give the file that has the joint."
            check(False, "joints", rule, repr(name), advice)
        check_choice("joints", name, self.joints)
        kind = self.joints[name].kind
        check(kind not in _IMMOBILE, f"joints[{name}]", "must be of a type with an axis", kind)

    def check_attribute(self, joint: str, attribute: str) -> None:
        """Check that a joint can have an attribute.

        Args:
            joint: its name.
            attribute: its name.

        Raises:
            ValueError: the format has no such attribute.
        """
        names = ATTRIBUTES[self.language]
        if self.language == "URDF" and attribute in ("armature", "stiffness"):
            rule = f"must have attributes of URDF: {', '.join(names)}"
            check(False, f"joints[{joint}]", rule, attribute, "MJCF has this one.")
        check_choice(f"joints[{joint}]", attribute, names)

    def unit(self, joint: str, attribute: str) -> str:
        """The unit of an attribute of a joint; "" where a default class may decide its type.

        Args:
            joint: its name.
            attribute: its name.
        """
        kind = self.joints[joint].kind
        if not kind and self.default_types:
            return ""
        units = _LINEAR if kind in _SLIDING else _ANGULAR
        return units[_QUANTITIES.get(attribute, attribute)]

    def with_values(self, values: Mapping[str, Mapping[str, float]]) -> bytes:
        """The content of the file with other values.

        Args:
            values: by joint and attribute.
        """
        edits = []
        for name, attributes in values.items():
            joint = self.joints[name]
            texts = {key.encode(): repr(float(value)).encode() for key, value in attributes.items()}
            if self.language == "MJCF":
                edits += _attribute_edits(self.content, joint.start, texts)
            elif "dynamics" in joint.children:
                edits += _attribute_edits(self.content, joint.children["dynamics"], texts)
            else:
                edits.append(self._new_dynamics(joint, texts))
        content = self.content
        for start, stop, text in sorted(edits, reverse=True):
            content = content[:start] + text + content[stop:]
        return content

    def _new_dynamics(self, joint: Joint, texts: Mapping[bytes, bytes]) -> tuple[int, int, bytes]:
        """The edit that adds `<dynamics>` behind the last child, indented as the first one."""
        content, tag = self.content, b"<dynamics" + _written(texts) + b"/>"
        head = _tag_end(content, joint.start)
        if joint.first_child < 0:
            self_closing = content[head - 2 : head] == b"/>"
            return (head - 2, head, b">" + tag + b"</joint>") if self_closing else (head, head, tag)
        lines = re.search(rb"\r?\n[ \t]*\Z", content[head : joint.first_child])
        place = joint.start + len(content[joint.start : joint.end].rstrip())
        return place, place, (lines[0] if lines else b"") + tag


def read_robot(path: str | Path) -> RobotFile:
    """A robot description, with the places of its joints.

    Args:
        path: of a URDF or MJCF file, in UTF-8 or another encoding that contains ASCII.

    Raises:
        ValueError: no file, no XML, a document that declares entities, neither URDF nor MJCF, two
            joints of the same name.

    Source: URDF, http://wiki.ros.org/urdf/XML/joint; MJCF, the XML reference of MuJoCo,
        https://mujoco.readthedocs.io/en/stable/XMLreference.html
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        check(False, "robot", f"must be a file that can be read ({error.strerror})", path)
        raise
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    check(not wide, "robot", "must be in UTF-8", f"UTF-16 in {path}")
    scanner = _Scanner(path)
    try:
        scanner.parser.Parse(content, True)
    except expat.ExpatError as error:
        check(False, "robot", f"must be an XML file ({error})", path)
    return RobotFile(content, scanner.language, scanner.joints, tuple(scanner.includes),
                     scanner.default_types)  # fmt: skip


class _Scanner:
    """Finds joints, and where they stand, while the parser reads."""

    def __init__(self, path: Path):
        self.path = path
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.stop
        self.parser.EntityDeclHandler = self.entity
        self.language = ""
        self.joints: dict[str, Joint] = {}
        self.includes: list[str] = []
        self.default_types = False
        self.ancestors: list[str] = []
        self.current: Joint | None = None
        self.depth = 0  # of the children of the current joint

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        if not self.ancestors:
            rule = "must be a URDF (<robot>) or an MJCF file (<mujoco>)"
            check(tag in _ROOTS, "robot", rule, f"<{tag}> in {self.path}")
            self.language = _ROOTS[tag]
        place = self.parser.CurrentByteIndex
        if self.current is not None and len(self.ancestors) == self.depth:
            self.current.children.setdefault(tag, place)
            if self.current.first_child < 0:
                self.current.first_child = place
        if tag == "joint" and "default" in self.ancestors:
            self.default_types |= "type" in attributes
        if tag in ("include", "xacro:include"):
            self.includes.append(attributes.get("file") or attributes.get("filename", ""))
        if tag == "joint" and "name" in attributes and self.is_joint():
            name = attributes["name"]
            rule = "must have a single joint of each name"
            check(name not in self.joints, "robot", rule, f"two of {name} in {self.path}")
            self.current = self.joints[name] = Joint(name, attributes.get("type", ""), place)
            self.depth = len(self.ancestors) + 1
        self.ancestors.append(tag)

    def stop(self, tag: str) -> None:
        del tag
        self.ancestors.pop()
        if self.current is not None and len(self.ancestors) == self.depth - 1:
            self.current.end = self.parser.CurrentByteIndex
            self.current = None

    def is_joint(self) -> bool:
        """Whether a joint stands here; else it refers to one."""
        if self.language == "MJCF":
            return not _REFERENCES.intersection(self.ancestors)
        return all(tag.startswith("xacro:") for tag in self.ancestors[1:])

    def entity(self, name: str, *declaration: object) -> None:
        del declaration
        check(False, "robot", "must not declare entities", f"{name} in {self.path}")


def _tag_end(content: bytes, start: int) -> int:
    """The place behind a start tag; its values may hold `>`."""
    place = start
    for attribute in _ATTRIBUTE.finditer(content, start):
        if b">" in content[place : attribute.start()]:
            break
        place = attribute.end()
    return content.index(b">", place) + 1


def _written(texts: Mapping[bytes, bytes]) -> bytes:
    return b"".join(b" " + name + b'="' + text + b'"' for name, text in texts.items())


def _attribute_edits(
    content: bytes, start: int, texts: Mapping[bytes, bytes]
) -> list[tuple[int, int, bytes]]:
    """Edits (start, stop, text) that give the tag at a place these attributes."""
    end, missing, edits = _tag_end(content, start), dict(texts), []
    place = start + re.match(rb"<[^\s/>]+", content[start:end]).end()  # type: ignore[union-attr]
    for attribute in _ATTRIBUTE.finditer(content, start, end):
        place = attribute.end()
        text = missing.pop(attribute[1], None)
        if text is not None:
            edits.append((attribute.start(2) + 1, attribute.end(2) - 1, text))
    return [*edits, (place, place, _written(missing))] if missing else edits

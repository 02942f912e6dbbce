"""Joints of URDF and MJCF files: only what is set changes, byte for byte."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from eoi_jax.models.export.joints import read_robot

URDF = """<?xml version="1.0" encoding="UTF-8"?>
<!-- Two joints: 'a' > "b" -->
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="base"/>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint
      type="revolute" name = 'shoulder'>
    <parent link="base"/>
    <child link="upper"/>   <!-- the upper arm -->
    <limit lower="-1.57" upper="1.57" effort="10" velocity="5"/>
    <dynamics damping = '0.1'/>
  </joint>
\t<joint name="elbow" type="continuous">
\t\t<parent link="upper"/>
\t\t<child link="lower > upper"/>
\t\t<!-- no dynamics yet -->
\t</joint>
  <xacro:if value="1"><joint name="slider" type="prismatic"><axis xyz="1 0 0"/></joint></xacro:if>
  <transmission name="t"><joint name="shoulder"><mechanicalReduction/></joint></transmission>
  <ros2_control name="c" type="system"><joint name="elbow"/></ros2_control>
</robot>
"""
MJCF = """<mujoco model="arm">
  <default>
    <joint damping="0.1" armature="0.01"/>
    <default class="soft"><joint name="shoulder" damping="0.2"/></default>
  </default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 0 1" damping="0.5" />
      <body name="lower"><joint class="soft" name="elbow"/><joint name="rail" type="slide"/></body>
    </body>
  </worldbody>
  <equality><joint name="coupled" joint1="shoulder" joint2="elbow"/></equality>
  <tendon><fixed name="rope"><joint joint="elbow" coef="1"/></fixed></tendon>
  <actuator><position name="elbow" joint="elbow"/></actuator>
</mujoco>
"""


@pytest.fixture
def read(tmp_path: Path):
    def written(text: str | bytes):
        path = tmp_path / "robot.xml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_robot(path)

    return written


def changed(before: str, after: bytes) -> list[tuple[str, str]]:
    lines = before.splitlines(), after.decode().splitlines()
    return [(old, new) for old, new in zip(*lines, strict=True) if old != new]


def test_joints_are_those_that_bodies_have_not_what_refers_to_them(read):
    assert list(read(URDF).joints) == ["mount", "shoulder", "elbow", "slider"]
    assert list(read(MJCF).joints) == ["shoulder", "elbow", "rail"]


def test_only_the_attributes_that_are_set_change(read):
    after = read(URDF).with_values({"shoulder": {"damping": 0.25, "friction": 1e-3}})
    old, new = "<dynamics damping = '0.1'/>", "<dynamics damping = '0.25' friction=\"0.001\"/>"
    assert changed(URDF, after) == [(f"    {old}", f"    {new}")]
    after = read(MJCF).with_values({"elbow": {"frictionloss": 0.5, "damping": 2.0}})
    head = '      <body name="lower"><joint class="soft" name="elbow"'
    tail = '/><joint name="rail" type="slide"/></body>'
    values = ' frictionloss="0.5" damping="2.0"'
    assert changed(MJCF, after) == [(head + tail, head + values + tail)]


def test_several_joints_are_set_at_once_and_without_values_nothing_changes(read):
    file = read(MJCF)
    assert file.with_values({}) == MJCF.encode()
    once = file.with_values({"rail": {"damping": 3.0}, "shoulder": {"damping": 1.0}})
    again = read(file.with_values({"shoulder": {"damping": 1.0}}))
    assert again.with_values({"rail": {"damping": 3.0}}) == once


def test_dynamics_are_added_where_there_are_none_indented_as_its_neighbours(read):
    after = read(URDF).with_values({"elbow": {"friction": 0.5}}).decode()
    comment = "\t\t<!-- no dynamics yet -->\n"
    assert after == URDF.replace(comment, comment + '\t\t<dynamics friction="0.5"/>\n')
    after = read(URDF).with_values({"slider": {"damping": 7.0}}).decode()
    axis = '<axis xyz="1 0 0"/>'
    assert after == URDF.replace(axis, axis + '<dynamics damping="7.0"/>')
    for empty in ('<joint name="a" type="revolute"/>', '<joint name="a" type="revolute"></joint>'):
        after = read(f"<robot>{empty}</robot>").with_values({"a": {"damping": 1.0}})
        joint = '<joint name="a" type="revolute"><dynamics damping="1.0"/></joint>'
        assert after.decode() == f"<robot>{joint}</robot>"


def test_line_ends_and_encodings_are_kept(read):
    text = URDF.replace("\n", "\r\n").replace("UTF-8", "ISO-8859-1").replace("the upper", "Größe")
    after = read(text.encode("latin-1")).with_values({"elbow": {"damping": 1.0}})
    comment = "\t\t<!-- no dynamics yet -->\r\n"
    assert after.decode("latin-1") == text.replace(
        comment, comment + '\t\t<dynamics damping="1.0"/>\r\n'
    )
    text = MJCF.replace("arm", "Größe")
    after = read(text.encode("utf-8-sig")).with_values({"rail": {"damping": 1.0}})
    assert after.startswith(b"\xef\xbb\xbf<mujoco")
    slide = 'type="slide"'
    assert after.decode("utf-8-sig") == text.replace(slide, f'{slide} damping="1.0"')


def test_the_result_is_the_document_with_other_values(read):
    values = {"shoulder": {"damping": 0.1 + 0.2}, "elbow": {"damping": 4.0, "friction": 5.0}}
    root = ElementTree.fromstring(read(URDF).with_values(values))
    found = {
        joint.get("name"): {key: float(value) for key, value in dynamics.attrib.items()}
        for joint in root.findall("joint")
        for dynamics in joint.findall("dynamics")
    }
    assert found == values
    assert len(list(root.iter())) == len(list(ElementTree.fromstring(URDF).iter())) + 1


def test_units_are_those_of_what_the_joint_does(read):
    urdf, mjcf = read(URDF), read(MJCF)
    assert urdf.unit("shoulder", "damping") == mjcf.unit("elbow", "damping") == "N m s/rad"
    assert urdf.unit("slider", "friction") == mjcf.unit("rail", "frictionloss") == "N"
    assert mjcf.unit("elbow", "armature") == "kg m²"
    assert mjcf.unit("rail", "stiffness") == "N/m"
    typed = read(MJCF.replace('<joint damping="0.1" ', '<joint damping="0.1" type="slide" '))
    assert typed.unit("elbow", "damping") == ""
    assert typed.unit("rail", "damping") == "N s/m"


INCLUDED = '<mujoco><include file="joints.xml"/><worldbody/></mujoco>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no: xml", "`robot` must be an XML file (syntax error: line 1, column 0), got"),
        ("<robot><joint></robot>", "`robot` must be an XML file (mismatched tag: line 1"),
        ("<sdf/>", "`robot` must be a URDF (<robot>) or an MJCF file (<mujoco>), got <sdf> in"),
        ('<!DOCTYPE robot [<!ENTITY a "b">]><robot/>', "`robot` must not declare entities, got a"),
        (MJCF.encode("utf-16"), "`robot` must be in UTF-8, got UTF-16 in"),
        (
            '<robot><joint name="a"/><joint name="a"/></robot>',
            "`robot` must have a single joint of each name, got two of a in",
        ),
    ],
)
def test_what_is_no_robot_is_refused(read, text, message):
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        read(text)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"`robot` must be a file that can be read \(No such fil"):
        read_robot(tmp_path / "none.urdf")


NO_JOINT = {
    "elbo": "`joints` must be one of mount, shoulder, elbow, slider, got 'elbo'. "
    "Did you mean `elbow`?",
    "mount": "`joints[mount]` must be of a type with an axis, got fixed.",
}
OTHER = "`joints` must be one of shoulder, elbow, rail, got 'coupled'."
ELSEWHERE = (
    "`joints` must be a joint of this file (none), got 'elbow'. "
    "It includes joints.xml: give the file that has the joint."
)


@pytest.mark.parametrize(
    ("text", "joint", "message"),
    [
        *((URDF, joint, message) for joint, message in NO_JOINT.items()),
        (MJCF, "coupled", OTHER),
        (INCLUDED, "elbow", ELSEWHERE),
    ],
)
def test_a_joint_that_is_not_there_is_refused(read, text, joint, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        read(text).check_joint(joint)


def test_an_included_file_can_be_given_itself(read):
    file = read('<mujocoinclude><body><joint name="elbow"/></body></mujocoinclude>')
    file.check_joint("elbow")
    assert b'name="elbow" damping="1.0"/>' in file.with_values({"elbow": {"damping": 1.0}})


NO_ATTRIBUTE = {
    "armature": "`joints[elbow]` must have attributes of URDF: damping, friction, got armature. "
    "MJCF has this one.",
    "frictionloss": "`joints[elbow]` must be one of damping, friction, got 'frictionloss'. "
    "Did you mean `friction`?",
}
NO_FRICTION = (
    "`joints[elbow]` must be one of damping, frictionloss, armature, stiffness, got 'friction'. "
    "Did you mean `frictionloss`?"
)


@pytest.mark.parametrize(
    ("text", "attribute", "message"),
    [
        *((URDF, attribute, message) for attribute, message in NO_ATTRIBUTE.items()),
        (MJCF, "friction", NO_FRICTION),
    ],
)
def test_an_attribute_that_the_format_lacks_is_refused(read, text, attribute, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        read(text).check_attribute("elbow", attribute)

"""URDFs of arms that no maker has: bare chains of five to seven joints, as public ones are written."""

from __future__ import annotations

from pathlib import Path

LINK = '<link name="{name}">{inertial}</link>'
INERTIAL = ('<inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>'
            '<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>')
SIX = (("0 0 1", "0 0 0.2"), ("0 1 0", "0 0 0.2"), ("0 1 0", "0 0 0.45"), ("1 0 0", "0.2 0 0"), ("0 1 0", "0.25 0 0"),
       ("1 0 0", "0.1 0 0"))
"""Axis and place of each joint: a wrist of three axes that meet nearly, tool along x."""
SEVEN = (("0 0 1", "0 0 0.15"), ("0 1 0", "0 0 0.2"), ("0 0 1", "0 0 0.2"), ("0 -1 0", "0 0 0.2"), ("0 0 1", "0 0 0.2"),
         ("0 1 0", "0 0 0.2"), ("0 0 1", "0 0 0.1"))
FIVE = (("0 0 1", "0 0 0.1"), ("0 1 0", "0 0 0.1"), ("0 1 0", "0 0 0.3"), ("0 1 0", "0 0 0.3"), ("0 0 1", "0 0 0.1"))
TURNED = {6: "0 1.5707963 0", 7: "0 0 0", 5: "0 0 0"}
"""From the last link to the tool frame."""
GRIPPER = """<link name="hand"/><joint name="hand_joint" type="fixed"><parent link="tool0"/><child link="hand"/><axis xyz="0 0 0"/></joint>
<link name="left"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="left_finger" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="0 1 0"/>
<limit lower="0.01" upper="0.04" effort="20" velocity="0.2"/></joint>
<link name="right"/><joint name="right_finger" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="0 -1 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="0.2"/><mimic joint="left_finger"/></joint>"""  # noqa: E501


def urdf(joints: int = 6, *, mass: float | None = None, limit: str = 'lower="-2.9" upper="2.9" effort="0" velocity="0"',
         beyond: str = "", kind: str = "revolute") -> str:
    """A bare kinematic chain, its first joint of a kind, with what is fixed beyond its tool frame.

    Args:
        joints: 5, 6 or 7.
        mass: of each link [kg]; no inertial elements if None.
        limit: attributes of every joint's limit.
        beyond: further links and joints.
        kind: of the first joint.
    """
    chain = {5: FIVE, 6: SIX, 7: SEVEN}[joints]
    parts = ['<robot name="bare"><link name="base_link"/>']
    for i, (axis, place) in enumerate(chain, 1):
        inertial = "" if mass is None else INERTIAL.format(mass=mass, inertia=0.01 * mass)
        parts.append(LINK.format(name=f"link_{i}", inertial=inertial))
        parts.append(f'<joint name="joint_{i}" type="{kind if i == 1 else "revolute"}">'
                     f'<parent link="{"base_link" if i == 1 else f"link_{i - 1}"}"/><child link="link_{i}"/>'
                     f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit {limit}/></joint>')
    tip = "0.1 0 0" if joints == 6 else "0 0 0.1"
    parts.append(f'<link name="tool0"/><joint name="flange" type="fixed"><parent link="link_{joints}"/>'
                 f'<child link="tool0"/><origin xyz="{tip}" rpy="{TURNED[joints]}"/>'
                 '<axis xyz="0 0 0"/></joint>')
    # ROS-Industrial's second frame at the base, which stands behind the tool in the file.
    parts.append('<link name="base"/><joint name="base_fixed" type="fixed"><parent link="base_link"/>'
                 f'<child link="base"/></joint>{beyond}</robot>')
    return "\n".join(parts)


def written(folder: Path, text: str, name: str = "bare") -> Path:
    """The URDF as a file in a folder."""
    path = folder / f"{name}.urdf"
    path.write_text(text, encoding="utf-8")
    return path

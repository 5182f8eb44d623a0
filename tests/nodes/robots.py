"""Small robots for the tests of robot_state and joints."""

import tfbus

ARM = """
<robot name="arm">
  <link name="base"/><link name="upper"/><link name="lower"/><link name="left"/>
  <link name="right"/><link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="3" effort="1" velocity="2"/>
    <safety_controller soft_lower_limit="-0.5" soft_upper_limit="9" k_velocity="1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="grip" type="prismatic">
    <parent link="lower"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0.1" upper="0.3" effort="1" velocity="0.1"/>
  </joint>
  <joint name="grip_right" type="prismatic">
    <parent link="lower"/><child link="right"/><axis xyz="0 1 0"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/>
    <mimic joint="grip" multiplier="-1" offset="0.5"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="lower"/><child link="tool"/><origin xyz="0 0 1"/>
  </joint>
</robot>
"""

FREE = ("shoulder", "elbow", "grip")


def arm() -> tfbus.Robot:
    """The arm."""
    return tfbus.Robot.from_text(ARM)

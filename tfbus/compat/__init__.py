"""Names of other libraries, for programs that are ported.

Packages of ROS's interfaces, as tfbus.compat.nav_msgs.msg, are made from their definitions.
"""

from tfbus.compat.modules import install

install()

"""Services of ROS 2 package tf2_msgs.

Their classes are made of the files beside this one.
"""

from cairn.schemas.interfaces import package_of

__getattr__, __dir__ = package_of(__name__)

"""Messages of ROS 2 package builtin_interfaces."""



from cairn.schemas.builtin_interfaces import Duration as Duration

from cairn.schemas.builtin_interfaces import Time as Time

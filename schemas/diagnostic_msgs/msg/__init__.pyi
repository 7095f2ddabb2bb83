"""Messages of ROS 2 package diagnostic_msgs."""



from cairn.schemas.diagnostic_msgs import DiagnosticArray as DiagnosticArray

from cairn.schemas.diagnostic_msgs import DiagnosticStatus as DiagnosticStatus

from cairn.schemas.diagnostic_msgs import KeyValue as KeyValue

"""The guest's tests are for the guest alone."""

import os

collect_ignore = [] if os.environ.get("CAIRN_HARDWARE_GUEST") else ["booted", "guest"]

"""The conformance kit: with it, users test their drivers and deployments. It needs pytest."""

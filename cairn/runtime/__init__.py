"""What a component is: its ports, handlers, parameters, life cycle and loop."""

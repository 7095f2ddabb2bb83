"""The control components, one for each framework of the navigation system."""

"""Records what the components of a deployment publish."""

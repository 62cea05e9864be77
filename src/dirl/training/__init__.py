"""The functions that the recipes' training loops call, from configuration to update."""

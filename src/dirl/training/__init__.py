"""From a configuration to updates: the pieces that the recipes' loops are made of."""

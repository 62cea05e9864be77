"""Where scenes come from besides files: a simulator, photographs."""

"""Sources of scenes besides files: a simulator, photographs."""

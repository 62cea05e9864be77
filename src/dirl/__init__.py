"""Target-driven visual navigation by deep imitation reinforcement learning."""

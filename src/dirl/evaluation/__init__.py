"""Experts, episodes, and the protocol and metrics of evaluation."""

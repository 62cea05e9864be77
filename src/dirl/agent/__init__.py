"""The agent: policy, memory and recogniser; maps of walks; the navigator for images."""

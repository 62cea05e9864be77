"""What the commands share: how they start and end, help and completion, options, one-line errors."""

"""What becomes a scene: photographs, recordings, simulators, 360-degree tours, generated rooms."""

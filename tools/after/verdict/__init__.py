"""What a run came to: judged, summed up, told."""

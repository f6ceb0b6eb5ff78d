"""Laws that users write: found, kept whole in a log, tried before they run, their errors told."""

"""What drives on a bus have in common: identity, gains, outbox, ways; in no protocol."""

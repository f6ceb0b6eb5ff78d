"""Two chains of difference equations behind two deadzones or gaps, of chapters 4 and 5."""

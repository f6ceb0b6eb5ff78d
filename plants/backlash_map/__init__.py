"""A map driven through backlash: the discrete-time example of the book's chapter 5."""

"""A pendulum driven through backlash: the continuous-time example of the book's chapter 5."""

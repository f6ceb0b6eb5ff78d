"""Many runs and what they show: campaigns, margins, fits, theorems, studies."""

TITLE, PLACE = "many runs and studies", 5  # in `pcpc help`

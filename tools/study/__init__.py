"""Many runs and what they show: campaigns, margins, fits, theorems, studies."""

"""Laws: blocks, their functions, controllers, approximators, models, references."""

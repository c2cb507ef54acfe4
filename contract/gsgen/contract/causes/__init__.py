"""Which mistake explains a model's rows? Each explanation is undone, tried and scored alike."""

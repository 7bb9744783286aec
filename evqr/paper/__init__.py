"""The paper's experiment: methods, data set, evaluation and commands.  Nothing of the product imports it."""

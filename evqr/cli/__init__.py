"""The commands of the product, and what all commands share."""

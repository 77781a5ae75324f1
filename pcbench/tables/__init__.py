"""Tables of a result as a paper has them: observers by signals or by the values of an axis, the best marked."""

"""Methods of other papers that the tables compare ViewNet with, one file each, and what they are to the rest (peer)."""

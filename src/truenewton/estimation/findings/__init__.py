"""What was found in data beside the model.

catalogue   the codes of findings, what each is about and how it reads
finding     the record of one finding
"""

"""The outputs of the commands are compared with the recorded ones."""

from reference import golden


def test_the_same_commands_write_the_same_bytes():
    first, second = golden.outputs(["prove"]), golden.outputs(["prove"])
    assert len(first) == 4  # three commands and a figure
    assert first == second


def test_another_output_is_seen_on_this_and_another_machine():
    text = "exit code 0\nactuator 1: alpha 0.91\nactuator 2: alpha 0.93\n"
    old = golden.summary("a.txt", text.encode())
    for change, same_machine, elsewhere in (
        ("0.93", 0, 0),
        ("0.93000001", 1, 0),
        ("0.94", 1, 1),
        ("0.93 doubtful", 1, 1),
        ("0.93 0.94", 2, 2),
    ):
        new = golden.summary("a.txt", text.replace("0.93", change).encode())
        assert len(golden.differences(old, new, bytewise=True)) == same_machine
        assert len(golden.differences(old, new, bytewise=False)) == elsewhere

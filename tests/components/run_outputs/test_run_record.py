"""What the report says of an object's moves, when some of them are taken back."""

from cairn.components.run_outputs.run_record import ObjectMove, ObjectMoves

HERE, THERE, ELSEWHERE = (1.0, 2.0), (3.0, 2.0), (0.0, 5.0)


def test_move_is_a_removal_and_a_registration() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.registered(20)

    assert moves.last == ObjectMove(HERE, 10, 20)


def test_restored_object_is_not_counted_as_moved() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.restored(HERE)

    assert moves.last == ObjectMove(None, None)


def test_undoing_a_later_move_keeps_the_earlier_one() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.registered(20)
    moves.removed(30, (THERE[0] + 0.05, THERE[1]))  # refined since it was registered
    moves.restored(THERE)

    assert moves.last == ObjectMove(HERE, 10, 20)


def test_several_moves_are_undone_at_once() -> None:
    moves = ObjectMoves()
    for stamp, left in ((10, HERE), (30, THERE), (50, ELSEWHERE)):
        moves.removed(stamp, left)
        moves.registered(stamp + 5)
    moves.restored(THERE)

    assert moves.last == ObjectMove(HERE, 10, 15)


def test_object_that_loses_its_position_again_is_not_counted_as_registered() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.registered(20)
    moves.removed(30, THERE)
    moves.restored(None)

    assert moves.last == ObjectMove(HERE, 10, None)


def test_unmapped_object_is_only_registered() -> None:
    moves = ObjectMoves()
    moves.registered(20)

    assert moves.last == ObjectMove(None, None, 20)
    moves.restored(None)
    assert moves.last == ObjectMove(None, None, None)


def test_undone_registration_of_an_unmapped_object_is_forgotten() -> None:
    moves = ObjectMoves()
    moves.registered(20)
    moves.removed(30, THERE)
    moves.restored(None)

    assert moves.standing == []

"""What the report says of an object's moves, when some of them are taken back."""

from cairn.components.report.run_record import ObjectMove, ObjectMoves

HERE, THERE, ELSEWHERE = (1.0, 2.0), (3.0, 2.0), (0.0, 5.0)


def test_a_move_is_a_removal_and_a_registration() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.registered(20)

    assert moves.last == ObjectMove(HERE, 10, 20)


def test_an_object_restored_to_its_place_never_moved() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.restored(HERE)

    assert moves.last == ObjectMove(None, None)


def test_taking_back_a_later_move_leaves_the_one_that_holds() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.registered(20)
    moves.removed(30, (THERE[0] + 0.05, THERE[1]))  # refined since it was registered
    moves.restored(THERE)

    assert moves.last == ObjectMove(HERE, 10, 20)


def test_several_moves_are_taken_back_at_once() -> None:
    moves = ObjectMoves()
    for stamp, left in ((10, HERE), (30, THERE), (50, ELSEWHERE)):
        moves.removed(stamp, left)
        moves.registered(stamp + 5)
    moves.restored(THERE)

    assert moves.last == ObjectMove(HERE, 10, 15)


def test_an_object_sought_for_again_was_not_registered() -> None:
    moves = ObjectMoves()
    moves.removed(10, HERE)
    moves.registered(20)
    moves.removed(30, THERE)
    moves.restored(None)

    assert moves.last == ObjectMove(HERE, 10, None)


def test_an_object_that_the_map_lacked_is_registered_only() -> None:
    moves = ObjectMoves()
    moves.registered(20)

    assert moves.last == ObjectMove(None, None, 20)
    moves.restored(None)
    assert moves.last == ObjectMove(None, None, None)


def test_a_registration_that_is_taken_back_of_an_object_without_a_place_is_forgotten() -> None:
    moves = ObjectMoves()
    moves.registered(20)
    moves.removed(30, THERE)
    moves.restored(None)

    assert moves.standing == []

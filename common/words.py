"""Plain words for every code: a title, and what to do. One table for the command line and the console.

A message that comes with a code says *what* and *where*; these say it for somebody who stands at the object.
"""

from __future__ import annotations

from typing import NamedTuple


class Words(NamedTuple):
    """A title, and what to do ('' where the message that comes along says it)."""

    title: str
    what_to_do: str = ""


WORDS: dict[str, Words] = {
    # --- what is in view ---------------------------------------------------------------------------------------
    "no_object": Words("No object in view.", "Turn a side with a marker towards the camera."),
    "object_in_view": Words("An object is in view.", "Take it out of the picture for a background sample."),
    "ambiguous_pose": Words(
        "Two poses fit equally well.", "Turn the object by 5 degrees, show a second marker, or come nearer."
    ),
    "incomplete": Words("An object in view has no pose.", "Hold still, show a marker, or take it out of the picture."),
    "bad_pose": Words("The markers don't fit together.", "Check marker sizes and offsets in the rig file."),
    "contradicts": Words("The markers contradict each other.", "Check which marker sits on which side."),
    "bad_fit": Words("The object's pose is not exact enough.", "Hold still, come nearer, or give more light."),
    "blurred": Words("The picture is blurred.", "Hold still, give more light, or focus the camera."),
    "no_pose": Words("No pose follows from what is seen.", "Show more of the object's markers."),
    # --- cameras and frames ------------------------------------------------------------------------------------
    "no_camera": Words("There is no such camera.", "Take one of those named; 'tagmill status' lists them."),
    "camera": Words("The camera can't be used.", "Check its cable and its section of the rig file."),
    "camera_stuck": Words(
        "The camera's driver hangs.", "Its process is started anew; unplug the camera and plug it in."
    ),
    "cameras_failed": Words("Not all cameras did it.", "What the others gave is kept; see each camera's reason."),
    "no_frame": Words("No picture came from the camera.", "Check its cable; 'tagmill status' says how it is."),
    "frame_gone": Words("That frame is gone.", "Ask for a newer one, or leave 'frame' out."),
    "frame_lost": Words("The frame was overwritten too soon.", "The machine is too slow for this rate: record slower."),
    "not_due": Words("That frame is being recorded already.", "Try again with the next one."),
    "frame_skipped": Words("A frame was skipped.", "The camera goes on with the next one."),
    "not_new": Words("This view was taken already.", "Turn the object."),
    "end_of_stream": Words("The file camera is at its end.", "Start a new recording to play it again."),
    "pixels_gone": Words("The picture was lost before it was saved.", "Try again; the label service was restarted."),
    # --- saving ------------------------------------------------------------------------------------------------
    "thinned": Words("Some frames are left out, evenly.", "The machine or its disk can't keep up: record slower."),
    "backlog_full": Words("The disk can't keep up.", "Record slower, or wait until the backlog is gone."),
    "store_down": Words(
        "Saving is stopped (store is restarting).", "Nothing recorded so far is lost; try again in a few seconds."
    ),
    "detect_down": Words(
        "Nobody looks for markers (detect is restarting).",
        "Try again in a few seconds; if it stays so, look at detect in `tagmill status`.",
    ),
    "labels_late": Words("Labels come late.", "The machine is too busy: record slower, or use fewer cameras."),
    "label_down": Words("Labelling is stopped (label is restarting).", "Try again in a few seconds."),
    "disk_full": Words("The disk is full.", "Free some space or choose another session."),
    "disk_error": Words("The disk can't be written.", "Look at the system's log; the disk may be failing."),
    "read_only": Words(
        "The dataset's folder can't be written.", "Check its owner and whether it is mounted read-only."
    ),
    "no_dataset": Words("The dataset's folder is gone.", "Mount its disk again."),
    "no_space": Words("Shared memory is too small.", "Free some of /dev/shm, or lower ring.samples in the rig file."),
    "worker_died": Words("A saving process died.", "It was replaced; try again. If it repeats, is memory short?"),
    "bad_sample": Words("A sample was refused by the store.", "This is a mistake in tagmill; see the log of store."),
    "bad_dataset": Words("The dataset can't be read.", ""),
    "damaged": Words("A file of the dataset is damaged.", "Restore it, or go on in a new session."),
    "missing_file": Words("A file of the dataset is missing.", "Restore it, or go on in a new session."),
    "other_schema": Words("The dataset is of another tagmill.", "Use the tagmill that wrote it, or a newer one."),
    # --- printing ----------------------------------------------------------------------------------------------
    "bad_board": Words("The board can't be as described.", "'tagmill markers board --help' has what can be chosen."),
    "no_board": Words("There is no such board.", "Name a description that lies beside the rig file."),
    "no_calibration": Words("No calibration is taking views.", "Start one first."),
    "judging": Words("The calibration is being judged."),
    "paper_too_small": Words("It doesn't fit the paper."),
    "nothing_to_print": Words("There is nothing to print.", "Give a side of an object its marker in the rig file."),
    "not_written": Words("The file can't be written.", "Choose another place."),
    # --- recordings and sessions -------------------------------------------------------------------------------
    "no_recording": Words("There is no such recording.", "'tagmill status' lists those that run."),
    "no_session": Words("No session is open.", "'tagmill status' says why; open one with 'tagmill session NAME'."),
    "session_differs": Words(
        "That session was recorded with another rig.",
        "Choose another session (for a reload: dataset.session), or put the rig back; 'tagmill session NAME "
        "--new-if-different' and 'tagmill up --new-session' open NAME-2.",
    ),
    "session_busy": Words("Another stack writes to that session.", "Stop it, or choose another session."),
    "bad_name": Words("That name can't be used.", "Use letters, digits, '.', '_' and '-'."),
    "wrong_state": Words("Not now.", "Stop what is being recorded first: 'tagmill stop'."),
    "needs_restart": Words("The stack must be restarted for that.", "'tagmill down', then 'tagmill up'."),
    "bad_config": Words(
        "That can't be used as it is.", "Correct it; 'tagmill check' says all that is wrong with a rig file."
    ),
    # --- samples -----------------------------------------------------------------------------------------------
    "no_sample": Words("There is no such sample.", "'tagmill dataset list' names them, with --bin those in the bin."),
    "nothing_to_undo": Words(
        "There is nothing to undo.", "Deleted samples are listed by 'tagmill dataset list --bin'."
    ),
    "session_exists": Words("There is such a session already.", "Choose another name with --into."),
    "no_rerun": Words("The viewer can't be opened."),
    "no_screen": Words("The viewer can't be opened."),
    "no_original": Words("The originals were not kept.", "Record with 'dataset: {keep_original: true}' next time."),
    "no_dictionary": Words("The session's marker dictionary isn't there.", "Name the rig file with --rig."),
    "no_class": Words("There is no such class.", "'tagmill inspect SESSION' lists them."),
    "unknown_session": Words("There is no such session.", "Sessions are the folders below dataset.root."),
    # --- the stack and its sockets -----------------------------------------------------------------------------
    "timeout": Words(
        "Time is up.", "What is on its way is still saved; the recording's ledger says what became of it."
    ),
    "no_answer": Words("No answer."),
    "busy": Words("Too much at once.", "Ask again in a moment."),
    "stopping": Words("tagmill is going down.", "What was ordered so far is settled in its ledger."),
    "name_taken": Words("That runs already.", "Stop the other one first, or use another TAGMILL_PREFIX."),
    "no_supervisor": Words("No stack runs here.", "Start it with 'tagmill up --rig rig.yaml'."),
    "no_start": Words("The stack did not start.", "See the log that is named."),
    "unknown_service": Words("There is no such service.", "'tagmill status' lists them."),
    "keys_exist": Words("There are keys already.", "Add a client with --client NAME, or remove the old keys first."),
    "bad_request": Words("That is no command.", "'tagmill help' shows what one looks like."),
    "bad_order": Words("Two services don't understand each other.", "Are all of the same release? Restart the stack."),
    "bad_message": Words(
        "Two services don't understand each other.", "Are all of the same release? Restart the stack."
    ),
    # --- exporting --------------------------------------------------------------------------------------------
    "bad_out": Words("The export can't go there."),
    # --- calibrating ------------------------------------------------------------------------------------------
    "no_picture": Words("There is no picture to look at."),
    "no_views": Words("The kept views can't be used.", "Look for the board anew with --images or --video."),
    "no_view": Words("There is no such view.", "Take one of those that the report lists as used."),
    # --- commands ----------------------------------------------------------------------------------------------
    "not_a_command": Words("That is no command.", "'tagmill help' shows what one looks like."),
    "unknown_command": Words("There is no such command.", "'tagmill help' lists them."),
    "unknown_field": Words("That command has no such field.", "'tagmill help' lists its fields."),
    "missing_field": Words("The command lacks a field.", "'tagmill help' lists its fields."),
    "wrong_type": Words("A field has the wrong kind of value.", "'tagmill help' says what it may be."),
    "out_of_bounds": Words("A value is out of bounds.", "'tagmill help' says what it may be."),
    "refused": Words("Refused."),
    "failed": Words("A mistake in tagmill itself.", "Please report it with the log of the service that is named."),
}


def words_for(code: str) -> Words:
    """The words for a code; one that has no row is shown as it is."""
    return WORDS.get(code) or Words(code.replace("_", " ").capitalize() + ".")

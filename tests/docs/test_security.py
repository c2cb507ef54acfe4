"""What the page on security promises is proved by tests that exist."""

import ast

import pytest

from support.commands import ROOT

PROOFS = {
    "Models run in a child process": [
        "contract/probing/test_sandbox.py::test_a_custom_operator_is_a_fault_of_loading",
        "contract/process/test_confinement.py::test_a_confined_process_reaches_no_network_and_no_process",
        "contract/process/test_confinement.py::test_a_confined_process_reads_its_model_and_no_other_file_of_the_home",
        "contract/process/test_confinement.py::test_a_confined_process_writes_small_files_to_its_folder_alone",
        "cli/drawing/test_confined_models.py::test_a_hostile_model_ends_a_command_at_a_limit_with_one_line",
        "sdk/float16/test_hostile_models.py::test_a_hostile_model_ends_a_conversion_at_a_limit",
    ],
    "Checkpoints are read with": [
        "plugins/loading/test_hostile_archives.py::test_a_hostile_pickle_is_refused_in_one_line",
        "scripts/test_gates.py::test_untrusted_bytes_are_read_by_the_gates_alone",
    ],
    "Archives are read entry by entry": [
        "contract/process/test_array_files.py::test_a_damaged_file_is_refused_in_one_line_and_little_memory",
        "formats/test_hostile.py::test_a_gzip_bomb_is_unpacked_no_further_than_its_header_says",
        "contract/inputs/test_local_copies.py::test_no_member_of_an_archive_leaves_the_folder",
        "contract/inputs/test_local_copies.py::test_an_archive_that_unpacks_to_too_much_is_refused",
    ],
    "Files of web servers come": [
        "contract/fetching/test_hostile_answers.py::test_hostile_answer_is_one_error_in_time",
        "contract/fetching/test_hostile_answers.py::test_headers_go_to_the_origin_of_the_address_alone",
        "contract/inputs/test_hub_file.py::test_the_token_goes_to_the_hub_and_not_to_its_storage",
        "contract/inputs/test_hub_file.py::test_the_hub_leads_into_no_private_network",
        "contract/inputs/test_hub_file.py::test_the_hub_leads_to_no_other_plain_server",
        "contract/inputs/test_local_copies.py::test_weights_that_lead_elsewhere_are_not_fetched",
        "contract/inputs/test_local_copies.py::test_weights_named_like_an_address_stay_on_the_server",
        "contract/inputs/test_local_copies.py::test_an_unknown_scheme_is_refused",
    ],
    "The servers listen on": [
        "tiles/serving/test_server.py::test_path_that_leaves_the_folder_is_not_found",
        "tiles/serving/test_server.py::test_host_of_another_site_is_refused",
        "tiles/serving/test_server.py::test_pages_of_other_origins_read_only_what_the_user_allows",
        "tiles/serving/test_server.py::test_hidden_file_is_not_found",
    ],
    "Outputs are written under": [
        "cli/house_rules/test_unwritable.py::test_unwritable_output_is_one_line_with_exit_code_2",
        "cli/house_rules/test_outputs.py::test_file_size_limit_is_reported",
        "cli/house_rules/test_newcomers.py::test_outputs_do_not_overwrite_inputs",
    ],
    "Nothing is reported": [
        "cli/house_rules/test_nothing_is_sent.py::test_command_sends_and_stores_nothing",
        "cli/house_rules/test_nothing_is_sent.py::test_importing_any_package_sets_the_variable_unless_the_user_did",
    ],
}
"""Beginning of a promise → the tests that prove it, as pytest names them below ``tests``."""


def promises() -> list[str]:
    text = (ROOT / "SECURITY.md").read_text("utf-8")
    section = text.partition("## What gsgen does about it")[2].partition("### ")[0]
    return [line.removeprefix("- ") for line in section.splitlines() if line.startswith("- ")]


def test_every_promise_has_a_proof() -> None:
    unproved = [line for line in promises() if not line.startswith(tuple(PROOFS))]
    assert unproved == []
    assert len(promises()) == len(PROOFS)


@pytest.mark.parametrize("name", sorted({name for names in PROOFS.values() for name in names}))
def test_a_proof_is_a_test_that_exists(name: str) -> None:
    path, _, function = name.partition("::")
    tree = ast.parse((ROOT / "tests" / path).read_text("utf-8"))
    function_names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert function in function_names

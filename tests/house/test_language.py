"""Texts for users have no private words and few long sentences."""

from plain_words import Text, count, remarks, texts, without_code

SHARE = 0.02  # of sentences above 30 words
OF_THE_ENGINE = ("lane", "lanes")  # one run of a compiled loop over many


def test_texts_for_users_are_in_plain_words():
    found = count(texts())
    print(*found.private, *found.long, sep="\n")
    assert len(found.private) <= 5
    assert len(found.long) <= SHARE * found.sentences
    assert found.sentences > 3000


def test_docstrings_and_comments_of_the_package_are_in_plain_words():
    found = count(remarks())
    private = [line for line in found.private if line.split(": ")[1].lower() not in OF_THE_ENGINE]
    assert not private, "\n".join(private)


def test_private_words_and_long_sentences_are_found_in_prose_and_not_in_code():
    prose = (
        "It is told a delay. A filter believes `told` what it knows.\n\n```sh\ntold --anew\n```\n\n"
        + "word " * 31
        + "end."
    )
    found = count([Text("page", without_code(prose), True), Text("message", "made anew " * 31, False)])
    assert [line.split(": ")[1] for line in found.private] == ["told", "believes", "knows", *["anew"] * 31]
    assert [line.split(": ")[1] for line in found.long] == ["32 words"]
